"""Plant a truth, and it must be named; hide nothing, and nothing may be."""

import msgspec
import numpy as np
import pytest

from diagnosis.addition import add_effect, write_next_version
from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.report import sentence
from dynamics.effects import CATALOGUE
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle

SOME = {
    n: CATALOGUE[n]
    for n in ("rotor_drag", "wind", "mass", "thrust_constant", "inertia", "imu_bias", "gyro_bias", "time_delay")
}
FAULTS = {n: CATALOGUE[n] for n in ("rotor_drag", "mass", "imu_bias", "gyro_bias", "time_delay", "weak_rotor")}


@pytest.fixture(scope="module")
def plain(plain_flights, arpl_250g):
    return make_dataset(plain_flights, arpl_250g)


@pytest.fixture(scope="module")
def heavier(arpl_250g):
    """A vehicle file that claims 6 % more than the vehicle weighs."""
    body = msgspec.structs.replace(arpl_250g.body, mass=1.06 * arpl_250g.body.mass)
    return msgspec.structs.replace(arpl_250g, body=body)


def test_with_nothing_hidden_the_model_explains_the_flights(plain, arpl_250g):
    diagnosis = diagnose_dataset(plain, arpl_250g, CATALOGUE).diagnosis
    assert diagnosis.verdict == "explained"
    assert diagnosis.effects == ()
    assert all(c.after <= 1.2 * c.floor for c in diagnosis.channels.values())
    assert "explains" in sentence(diagnosis)


def test_a_wrong_mass_is_named_with_its_value_and_the_error_falls_to_the_floor(plain, heavier):
    diagnosis = diagnose_dataset(plain, heavier, SOME).diagnosis
    assert diagnosis.verdict in ("effect", "ambiguous")
    first = diagnosis.effects[0]
    assert first.name == "mass"
    assert first.parameters["ratio"].value == pytest.approx(1 / 1.06, rel=0.01)
    assert diagnosis.channels["mocap"].before > 2 * diagnosis.channels["mocap"].floor
    assert diagnosis.channels["mocap"].after < 1.1 * diagnosis.channels["mocap"].floor


def test_a_mass_that_is_far_off_is_no_thrust_constant_with_an_inertia(plain, arpl_250g):
    body = msgspec.structs.replace(arpl_250g.body, mass=arpl_250g.body.mass / 1.17)
    result = diagnose_dataset(plain, msgspec.structs.replace(arpl_250g, body=body), SOME)
    assert [effect.name for effect in result.diagnosis.effects] == ["mass"]
    assert result.diagnosis.effects[0].parameters["ratio"].value == pytest.approx(1.17, rel=0.005)


def test_a_drag_that_the_file_overstates_is_corrected(plain, arpl_250g):
    draggy = arpl_250g.with_effects(EffectUse("rotor_drag", {"coefficient": 2e-5}))
    diagnosis = diagnose_dataset(plain, draggy, SOME).diagnosis
    assert diagnosis.effects[0].name == "rotor_drag"
    assert diagnosis.effects[0].parameters["coefficient"].value == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "quantity", "change", "parameter", "value"),
    [
        ("imu_bias", "specific_force", [0.3, 0, 0], "x", 0.3),
        ("gyro_bias", "rate", [0, 0, 0.06], "z", 0.06),
    ],
)
def test_a_biased_sensor_is_distinguished_from_a_force(changed, arpl_250g, name, quantity, change, parameter, value):
    columns = {f"{quantity}_{axis}": (lambda old, off=off: old + off) for axis, off in zip("xyz", change, strict=True)}
    diagnosis = diagnose_dataset(make_dataset(changed(**columns), arpl_250g), arpl_250g, FAULTS).diagnosis
    assert [effect.name for effect in diagnosis.effects] == [name]
    assert diagnosis.effects[0].parameters[parameter].value == pytest.approx(value, rel=0.15)


def test_a_late_pose_is_distinguished_from_a_force(changed, arpl_250g):
    names = [f"position_{a}" for a in "xyz"] + [f"velocity_{a}" for a in "xyz"] + [f"attitude_{a}" for a in "wxyz"]
    late = changed(**dict.fromkeys(names, lambda old: np.concatenate([np.repeat(old[:1], 3), old[:-3]])))
    diagnosis = diagnose_dataset(make_dataset(late, arpl_250g), arpl_250g, FAULTS).diagnosis
    assert [effect.name for effect in diagnosis.effects] == ["time_delay"]
    assert diagnosis.effects[0].parameters["delay"].value == pytest.approx(0.03, abs=0.003)


def test_an_effect_that_helps_is_added_with_a_line_of_history(plain, heavier, tmp_path):
    added = add_effect("mass", plain, heavier, SOME, date="2026-01-02", command="alula add mass")
    file = tmp_path / "vehicle.toml"
    file.write_text("taken")
    second, third = (write_next_version(added.vehicle, file) for _ in range(2))
    assert (second.name, third.name) == ("vehicle.v2.toml", "vehicle.v3.toml")
    assert write_next_version(added.vehicle, second).name == "vehicle.v4.toml"
    assert file.read_text() == "taken"
    again = read_vehicle(second)
    assert again.effects[0].parameters["ratio"] == pytest.approx(1 / 1.06, rel=0.01)
    line = again.history[-1]
    assert (line.date, line.action, line.command) == ("2026-01-02", "added mass", "alula add mass")
    assert line.after["mocap"] < line.before["mocap"]
    assert len(line.flights) == len(plain.hashes)


def test_effects_of_the_file_are_fitted_again_with_the_added_one(plain, heavier):
    draggy = heavier.with_effects(EffectUse("rotor_drag", {"coefficient": 4e-6}))  # there is none
    added = add_effect("mass", plain, draggy, SOME, date="2026-01-02").vehicle
    assert [use.name for use in added.effects] == ["rotor_drag", "mass"]  # the file's own first
    assert added.effects[1].parameters["ratio"] == pytest.approx(1 / 1.06, rel=0.01)
    assert added.effects[0].parameters["coefficient"] < 4e-7


def test_diagnosis_too_fits_effects_of_the_file_beside_new_ones(plain, heavier):
    draggy = heavier.with_effects(EffectUse("rotor_drag", {"coefficient": 4e-6}))  # there is none
    result = diagnose_dataset(plain, draggy, SOME)
    values = {use.name: use.parameters for use in result.vehicle.effects}
    assert result.diagnosis.effects[0].name == "mass"
    assert values["mass"]["ratio"] == pytest.approx(1 / 1.06, rel=0.01)
    assert values["rotor_drag"]["coefficient"] < 6e-7


def test_an_effect_that_does_not_help_is_refused(plain, arpl_250g):
    with pytest.raises(DataError, match="was not added"):
        add_effect("wind", plain, arpl_250g, SOME, date="2026-01-02")


def test_an_effect_that_these_flights_cannot_show_is_refused(plain, arpl_250g):
    with pytest.raises(DataError, match="cannot show motor_lag"):
        add_effect("motor_lag", plain, arpl_250g, {**SOME, "motor_lag": CATALOGUE["motor_lag"]}, date="2026-01-02")


def test_an_unknown_effect_is_refused_with_the_nearest_one(plain, arpl_250g):
    with pytest.raises(RequestError, match="did you mean 'rotor_drag'"):
        add_effect("rotor_drg", plain, arpl_250g, SOME, date="2026-01-02")


def test_motor_lag_is_found_where_the_log_holds_commands(plain_flights, arpl_250g):
    from tests.diagnosis.conftest import with_columns

    without = {f"rotor_speed_{i}": None for i in range(4)}
    dataset = make_dataset([with_columns(f, without) for f in plain_flights], arpl_250g)
    some = {n: CATALOGUE[n] for n in ("motor_lag", "rotor_drag", "thrust_constant", "inertia", "time_delay", *FAULTS)}
    diagnosis = diagnose_dataset(dataset, arpl_250g, some).diagnosis
    assert diagnosis.effects[0].name == "motor_lag"
    assert diagnosis.effects[0].parameters["time_constant"].value == pytest.approx(0.035, rel=0.35)


def test_an_effect_outside_the_catalogue_is_called_unknown(plain, arpl_250g):
    """Moments of inertia a quarter too small in the file, of which this catalogue has none."""
    body = msgspec.structs.replace(arpl_250g.body, inertia=tuple(0.75 * each for each in arpl_250g.body.inertia))
    others = {n: SOME[n] for n in ("rotor_drag", "wind", "mass", "gyro_bias", "time_delay", "imu_bias")}
    diagnosis = diagnose_dataset(plain, msgspec.structs.replace(arpl_250g, body=body), others).diagnosis
    assert diagnosis.verdict == "unknown"
    assert diagnosis.leftover[0].channel.startswith("angular")
    assert "no effect of the catalogue explains" in sentence(diagnosis)


def test_an_effect_that_was_not_excited_is_listed_with_what_to_fly(plain_flights, arpl_250g):
    high = [flight for i, flight in enumerate(plain_flights) if i != 3]  # the third alone comes down to the ground
    result = diagnose_dataset(
        make_dataset(high, arpl_250g), arpl_250g, {**SOME, "ground_effect": CATALOGUE["ground_effect"]}
    )
    assert "ground_effect" in result.diagnosis.not_excited
    assert "mass" not in result.diagnosis.not_excited
    assert "ground" in result.diagnosis.next_flight
