"""Sensors that sit, point or wait elsewhere than the model has it are named as such, not as forces."""

import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from diagnosis.selection.visibility import can_show
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.compiled_flights import compiled_flights
from fixtures.mutated_flights import USUAL
from fixtures.planted import MANOEUVRES as OF_ALL_KINDS

NAMES = (
    "rotor_drag", "inertia", "centre_of_mass", "rotor_cant", "wind", "imu_bias", "imu_lever_arm", "imu_misalignment",
    "gyro_bias", "imu_scale", "gyro_scale", "time_delay", "attitude_delay", "pose_lever_arm",
    "rotor_delay", "axial_inflow", "translational_lift",
)  # fmt: skip
SOME = {name: CATALOGUE[name] for name in NAMES}
MANOEUVRES = ("line:laps=3,ramp=1", "yaw_spin:laps=3,ramp=1", "Lemniscate:laps=4,ramp=1.5,speed=0.9") * 2
CASES = {
    "imu_lever_arm": {"x": 0.02, "y": 0.0, "z": -0.03},
    "pose_lever_arm": {"x": 0.03, "y": 0.0, "z": 0.05},
    "imu_misalignment": {"x": 0.03, "y": 0.04, "z": 0.0},
    "attitude_delay": {"delay": 0.015},
    "imu_scale": {"ratio": 1.03},
    "gyro_scale": {"ratio": 0.97},
    "centre_of_mass": {"x": 0.003, "y": -0.004},
}


@pytest.mark.parametrize("name", CASES)
def test_a_sensor_out_of_place_is_named(arpl_250g, name):
    uses = [EffectUse(name, CASES[name])]
    flights = compiled_flights(arpl_250g, uses, catalogue=CATALOGUE, seed=4, manoeuvres=MANOEUVRES)
    diagnosis = diagnose_dataset(make_dataset(flights, arpl_250g), arpl_250g, SOME).diagnosis
    assert diagnosis.verdict == "effect"
    (effect,) = diagnosis.effects
    assert effect.name == name
    for parameter, value in CASES[name].items():
        assert effect.parameters[parameter].value == pytest.approx(value, abs=0.002)


@pytest.mark.parametrize(("delay", "seed"), [(0.005, 4), (0.012, 5), (0.03, 6)])
def test_rotors_that_are_logged_late_are_named_and_no_inflow(arpl_250g, delay, seed):
    uses = [EffectUse("rotor_delay", {"delay": delay})]
    flights = compiled_flights(arpl_250g, uses, catalogue=CATALOGUE, seed=seed, manoeuvres=OF_ALL_KINDS)
    diagnosis = diagnose_dataset(make_dataset(flights, arpl_250g), arpl_250g, SOME).diagnosis
    assert diagnosis.verdict == "effect"
    (effect,) = diagnosis.effects
    assert effect.name == "rotor_delay"
    fitted = effect.parameters["delay"]
    assert fitted.value == pytest.approx(delay, abs=0.0005)
    assert abs(fitted.value - delay) < 2 * fitted.std


def test_an_inflow_that_commands_show_may_be_commands_that_are_late(arpl_250g):
    """Late commands are no candidate, since a lag of the rotors is nearly the opposite; on slow flights without such a
    lag they look like inflow."""
    uses = [EffectUse("rotor_delay", {"delay": 0.005})]
    flights = compiled_flights(arpl_250g, uses, catalogue=CATALOGUE, seed=102, commands=True, manoeuvres=USUAL)
    dataset = make_dataset(flights, arpl_250g)
    assert not can_show(CATALOGUE["rotor_delay"], dataset.everything, arpl_250g, CATALOGUE)
    details = diagnose_dataset(dataset, arpl_250g, CATALOGUE)
    assert details.diagnosis.verdict == "unknown"
    assert not details.diagnosis.effects
