"""A canted rotor is put on its own rotor by the joint fit, beside a weak one, on quadrotors and hexarotors."""

from types import SimpleNamespace

import pytest

from diagnosis.data.dataset import make_dataset, read_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.estimation.alternatives import merged_pairs, on_decided_rotors
from diagnosis.estimation.equation_error import fit
from diagnosis.selection.regression_of_flights import make_regression
from dynamics.effects import CATALOGUE
from dynamics.vehicle_file import read_vehicle
from fixtures.outside_cases import LAYOUTS, Campaign, captured_flights, flown, vehicle_of, write_campaign
from fixtures.outside_sensors import Recorder

SOME = {n: CATALOGUE[n] for n in ("weak_rotor", "rotor_cant", "imu_bias", "gyro_bias", "time_delay")}
HIDDEN = {
    "weak_rotor": {"loss": 0.1, "rotor": 3.0},
    "rotor_cant": {"tangential": -0.014, "radial": -0.021, "rotor": 1.0},
}
SEEDS = {  # the first of each layout
    layout: next(s for s in range(100) if Campaign({}, {}, Recorder(), False, False, 1, s).layout == layout)
    for layout in LAYOUTS
}


@pytest.fixture(scope="module", params=LAYOUTS)
def regression(request, tmp_path_factory):
    campaign = Campaign(HIDDEN, {}, Recorder(), False, False, 5, SEEDS[request.param])
    (truths,) = flown([campaign])
    folder = tmp_path_factory.mktemp(request.param)
    write_campaign(campaign, truths, folder)
    vehicle = read_vehicle(folder / "vehicle.toml")
    data = read_dataset(sorted(map(str, folder.glob("*.csv"))), vehicle)
    made = make_regression(vehicle, SOME, data.fitted, data.flight_of)
    return SimpleNamespace(made=made, by_key={c.key: c for c in made.candidates})


@pytest.mark.parametrize("wrong", [0, 2, 3])
def test_a_cant_on_the_wrong_rotor_is_put_right(regression, wrong):
    weak, cant = regression.by_key["weak_rotor[3]"], regression.by_key[f"rotor_cant[{wrong}]"]
    decided = on_decided_rotors(regression.made, [weak, cant], regression.made.vehicle)
    assert [c.key for c in decided] == ["weak_rotor[3]", "rotor_cant[1]"]
    values = fit(regression.made, decided).values
    assert values["rotor_cant[1]", "tangential"] == pytest.approx(-0.014, abs=0.001)
    assert values["rotor_cant[1]", "radial"] == pytest.approx(-0.021, abs=0.001)
    assert values["weak_rotor[3]", "torque_loss"] == pytest.approx(0.0, abs=0.02)


def test_what_is_on_its_own_rotor_stays_there(regression):
    right = [regression.by_key["weak_rotor[3]"], regression.by_key["rotor_cant[1]"]]
    assert on_decided_rotors(regression.made, right, regression.made.vehicle) == right


def test_a_misread_speed_beside_another_rotors_torque_is_one_weak_rotor(tmp_path):
    """Its speed read too high and the torque that another one of its direction lost make the loss of thrust alone."""
    names = ("weak_rotor", "rotor_speed_fault", "imu_bias", "gyro_bias", "time_delay")
    campaign = Campaign({"weak_rotor": {"loss": 0.05, "rotor": 1.0}}, {}, Recorder(), False, False, 5, SEEDS["x"])
    (truths,) = flown([campaign])
    write_campaign(campaign, truths, tmp_path)
    vehicle = read_vehicle(tmp_path / "vehicle.toml")
    data = read_dataset(sorted(map(str, tmp_path.glob("*.csv"))), vehicle)
    made = make_regression(vehicle, {n: CATALOGUE[n] for n in names}, data.fitted, data.flight_of)
    by_key = {c.key: c for c in made.candidates}
    pair = [by_key["rotor_speed_fault[1]"], by_key["weak_rotor[0]"]]
    assert [c.key for c in merged_pairs(made, pair, vehicle)] == ["weak_rotor[1]"]


def test_a_weak_rotor_and_a_misread_speed_that_cancel_are_neither():
    """An inertia was named with a rotor that lost 61 % of its thrust and a sensor that reads 63 % of its speed."""
    hidden = {"inertia": {"ratio_x": 1.1323294990342034, "ratio_y": 0.9294652667073872, "ratio_z": 0.7534419357711086}}
    campaign = Campaign(hidden, {}, Recorder(400.0, noise=1.0983266196702641), False, False, 9, 406136707)
    (truths,) = flown([campaign])
    vehicle = vehicle_of(campaign)
    diagnosis = diagnose_dataset(
        make_dataset(captured_flights(campaign, truths), vehicle), vehicle, CATALOGUE
    ).diagnosis
    (named,) = diagnosis.effects
    assert "inertia" in (named.name, *named.ambiguous_with)
    assert named.rotor is None


def test_a_drag_of_the_body_beside_a_damping_is_a_drag_at_the_rotors(tmp_path):
    """Rotors that drag where they are brake the vehicle's turning, too."""
    hidden = {"rotor_drag": {"coefficient": 3e-5}}
    campaign = Campaign(hidden, {}, Recorder(), False, True, 5, SEEDS["x"])
    (truths,) = flown([campaign])
    write_campaign(campaign, truths, tmp_path)
    vehicle = read_vehicle(tmp_path / "vehicle.toml")
    data = read_dataset(sorted(map(str, tmp_path.glob("*.csv"))), vehicle)
    some = {n: CATALOGUE[n] for n in ("rotor_drag", "linear_drag", "rotational_damping", "imu_bias", "gyro_bias")}
    made = make_regression(vehicle, some, data.fitted, data.flight_of)
    by_key = {c.key: c for c in made.candidates}
    apart = [by_key["linear_drag"], by_key["rotational_damping"]]
    assert [c.key for c in merged_pairs(made, apart, vehicle)] == ["rotor_drag"]
    drag_and_bias = [by_key["rotor_drag"], by_key["imu_bias"]]
    assert merged_pairs(made, drag_and_bias, vehicle) == drag_and_bias
