"""Thrust that grows with another power of rotor speed than the square is named with that power."""

import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.compiled_flights import compiled_flights

NAMES = (
    "rotor_drag", "axial_inflow", "translational_lift", "thrust_constant", "thrust_exponent", "torque_constant",
    "mass", "inertia", "imu_bias", "gyro_bias", "time_delay",
)  # fmt: skip
SOME = {name: CATALOGUE[name] for name in NAMES}
MANOEUVRES = ("bob:laps=4,ramp=1,height=0.25", "line:laps=3,ramp=1", "Lemniscate:laps=4,ramp=1.5,speed=0.9") * 2


def test_a_thrust_that_grows_more_slowly_is_no_inertia(arpl_250g):
    planted = EffectUse("thrust_exponent", {"exponent": 1.75, "torque_exponent": 2.0})
    flights = compiled_flights(arpl_250g, [planted], catalogue=CATALOGUE, seed=7, manoeuvres=MANOEUVRES)
    diagnosis = diagnose_dataset(make_dataset(flights, arpl_250g), arpl_250g, SOME).diagnosis
    assert diagnosis.verdict == "effect"
    (effect,) = diagnosis.effects
    assert effect.name == "thrust_exponent"
    assert effect.parameters["exponent"].value == pytest.approx(1.75, abs=0.01)
    assert effect.parameters["torque_exponent"].value == pytest.approx(2.0, abs=0.01)
