"""A signal that was logged late is a fault of the log: what resembles it is no effect; one that is there is named."""

import numpy as np
import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.diagnose import diagnose_dataset
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.compiled_flights import compiled_flights
from fixtures.mutated_flights import USUAL, with_columns

DRAG = EffectUse("rotor_drag", {"coefficient": 3e-5})
NAMES = (
    "rotor_drag", "linear_drag", "parasitic_drag", "translational_lift", "axial_inflow", "battery_sag", "wind", "gust",
    "inertia", "centre_of_mass", "motor_lag", "imu_bias", "gyro_bias", "time_delay", "attitude_delay", "rotor_delay",
)  # fmt: skip
SOME = {name: CATALOGUE[name] for name in NAMES}


def late(flight, quantity, by):
    columns = [name for name in flight.columns if name.rpartition("_")[0] == quantity]
    return with_columns(flight, {c: np.interp(flight.time - by, flight.time, flight[c]) for c in columns})


def diagnosed(vehicle, uses, seed, *, commands, quantity="", by=0.0):
    flights = compiled_flights(vehicle, uses, catalogue=CATALOGUE, seed=seed, commands=commands, manoeuvres=USUAL)
    flights = [late(flight, quantity, by) for flight in flights] if by else flights
    return diagnose_dataset(make_dataset(flights, vehicle), vehicle, SOME)


@pytest.mark.parametrize(
    ("uses", "seed", "commands", "quantity", "by"),
    [
        ((), 103, False, "specific_force", -0.005),
        ((DRAG,), 103, True, "rotor_speed_command", 0.005),
    ],
    ids=["accelerometer", "commands"],
)
def test_a_signal_that_is_logged_late_is_no_inflow(arpl_250g, uses, seed, commands, quantity, by):
    details = diagnosed(arpl_250g, uses, seed, commands=commands, quantity=quantity, by=by)
    assert {effect.name for effect in details.diagnosis.effects} == {use.name for use in uses}


@pytest.mark.parametrize("commands", [False, True])
@pytest.mark.parametrize(
    "use",
    [EffectUse("axial_inflow", {"coefficient": 1.2e-5}), EffectUse("translational_lift", {"coefficient": 2e-3})],
    ids=lambda use: use.name,
)
def test_an_effect_that_is_there_is_no_late_signal(arpl_250g, use, commands):
    diagnosis = diagnosed(arpl_250g, (use,), 11, commands=commands).diagnosis
    assert [effect.name for effect in diagnosis.effects] == [use.name]
