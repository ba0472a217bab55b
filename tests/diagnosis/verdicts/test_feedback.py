"""A controller's answer to turbulence is no inertia, and no function of the state that a model lacks."""

import pytest

from diagnosis.data.dataset import make_dataset, read_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from fixtures.compiled_flights import compiled_flights
from fixtures.mutated_flights import USUAL, with_columns
from fixtures.outside_cases import Campaign, captured_flights, flown, vehicle_of, write_campaign
from fixtures.outside_sensors import Recorder


def test_the_answer_to_turbulence_is_not_named(tmp_path):
    """Below 1.5 Hz an inertia 1.46 times the file's fits these flights, by seven deviations; below 0.75 Hz none."""
    recorder = Recorder(100.0, noise=1.2058978854361704)
    campaign = Campaign({}, {}, recorder, lag_declared=False, fast=False, flights=9, seed=314211354)
    (truths,) = flown([campaign])
    write_campaign(campaign, truths, tmp_path)
    vehicle = read_vehicle(tmp_path / "vehicle.toml")
    dataset = read_dataset(sorted(tmp_path.glob("*.csv")), vehicle)
    diagnosis = diagnose_dataset(dataset, vehicle, CATALOGUE).diagnosis
    assert diagnosis.verdict == "explained"
    assert "inertia" in [one.name for one in diagnosis.refused]


def logged_by_px4(folder, hidden, drag, damping, seed):
    """Slow flights of the outside simulator as PX4 logs them, and their vehicle. drag, damping: of its file."""
    declared = {"linear_drag": {"coefficient": drag}, "rotational_damping": {"coefficient": damping}}
    recorder = Recorder(250.0, commands=True, pose="estimator")
    campaign = Campaign(hidden, declared, recorder, lag_declared=True, fast=False, flights=9, seed=seed)
    (truths,) = flown([campaign])
    write_campaign(campaign, truths, folder)
    vehicle = read_vehicle(folder / "vehicle.toml")
    return read_dataset(sorted(folder.glob("*.ulg")), vehicle), vehicle


def test_turbulence_that_commands_explain_by_the_answer_to_it_is_noise(tmp_path):
    """All columns together leave a twentieth of its torque about y near 1 Hz; nothing is missing in the rest."""
    dataset, vehicle = logged_by_px4(tmp_path, {}, 0.0659, 3.57e-5, 1763380004)
    diagnosis = diagnose_dataset(dataset, vehicle, CATALOGUE).diagnosis
    assert (diagnosis.verdict, diagnosis.leftover) == ("explained", ())


def logged_without(vehicle, seed, quantities, uses=()):
    """Three flights that lack quantities of the pose."""
    flights = compiled_flights(vehicle, list(uses), catalogue=CATALOGUE, seed=seed, manoeuvres=tuple(USUAL))
    names = [name for name in flights[0].columns if name.rpartition("_")[0] in quantities]
    return make_dataset([with_columns(flight, dict.fromkeys(names)) for flight in flights], vehicle)


@pytest.mark.parametrize(
    ("seed", "quantities"),
    [(141, ("position", "velocity", "attitude")), (142, ("position", "velocity"))],
    ids=["no pose", "no velocity"],
)
def test_a_log_without_a_pose_that_hides_nothing_is_explained(arpl_250g, seed, quantities):
    """What is left of a torque goes with the rate, which is most of the state where no velocity was logged."""
    dataset = logged_without(arpl_250g, seed, quantities)
    diagnosis = diagnose_dataset(dataset, arpl_250g, CATALOGUE).diagnosis
    assert (diagnosis.verdict, diagnosis.leftover) == ("explained", ())


def test_a_damping_that_the_catalogue_lacks_is_left_over(arpl_250g):
    """The controller's answer to turbulence looks like a damping below zero, and a true one is not taken for it."""
    damping = EffectUse("rotational_damping", {"coefficient": 4e-3})
    dataset = logged_without(arpl_250g, 143, (), [damping])
    without = {name: effect for name, effect in CATALOGUE.items() if name != damping.name}
    diagnosis = diagnose_dataset(dataset, arpl_250g, without).diagnosis
    assert diagnosis.verdict == "unknown"
    assert "predictable_from_state" in {one.test for one in diagnosis.leftover}


@pytest.fixture(scope="module")
def rough():
    """Gentle flights of an outside vehicle in strong turbulence of its rotors, and the vehicle; nothing is hidden."""
    recorder = Recorder(200.0, noise=1.979295853480063)
    campaign = Campaign({}, {}, recorder, lag_declared=False, fast=False, flights=9, seed=49986954)
    (truths,) = flown([campaign])
    vehicle = vehicle_of(campaign)
    return make_dataset(captured_flights(campaign, truths), vehicle), vehicle


def test_it_is_not_named_then(rough):
    dataset, vehicle = rough
    diagnosis = diagnose_dataset(dataset, vehicle, CATALOGUE).diagnosis
    assert (diagnosis.verdict, diagnosis.effects) == ("explained", ())


def test_what_turbulence_makes_of_the_state_is_not_left_over():
    """These flights were `unknown`, since the state predicts the torque by which it was made."""
    declared = {
        "rotor_drag": {"coefficient": 8.189e-7},
        "parasitic_drag": {"coefficient": 7.109e-4},
        "rotational_damping": {"coefficient": 1.331e-5},
        "blade_flapping": {"coefficient": 1.381e-9},
    }
    recorder = Recorder(100.0, noise=1.980297050200163)
    campaign = Campaign({}, declared, recorder, lag_declared=False, fast=False, flights=9, seed=478959773)
    (truths,) = flown([campaign])
    dataset = make_dataset(captured_flights(campaign, truths), vehicle_of(campaign))
    diagnosis = diagnose_dataset(dataset, vehicle_of(campaign), CATALOGUE).diagnosis
    assert (diagnosis.verdict, diagnosis.leftover) == ("explained", ())


@pytest.mark.parametrize(
    ("seed", "rate", "noise", "was"),
    [(49986954, 200.0, 1.979, "named"), (478959773, 100.0, 1.98, "refused")],
    ids=["1.27, 1.28, 1.11 by all resamples", "2.1, 2.1, 1.11, which makes the torques worse"],
)
def test_a_torque_constant_in_turbulence_is_no_inertia(seed, rate, noise, was):
    """Of the inertia that was named, or refused with nothing in its place, yaw is sure alone."""
    hidden = {"torque_constant": {"ratio": 0.9}}
    campaign = Campaign(hidden, {}, Recorder(rate, noise=noise), lag_declared=False, fast=False, flights=9, seed=seed)
    (truths,) = flown([campaign])
    dataset = make_dataset(captured_flights(campaign, truths), vehicle_of(campaign))
    diagnosis = diagnose_dataset(dataset, vehicle_of(campaign), CATALOGUE).diagnosis
    (named,) = diagnosis.effects
    assert diagnosis.verdict == "ambiguous"
    assert (named.name, named.parameters["ratio"].value) == ("torque_constant", pytest.approx(0.9, rel=0.02))
    assert "inertia" in named.ambiguous_with
    assert ("inertia" in [one.name for one in diagnosis.refused]) is (was == "refused")
