"""A controller that answers turbulence makes commands of the motion; with nothing hidden that is no inertia.

Twenty seeds of flights along one axis and of flights about all six, whose motors' commands are logged, on the
compiled vehicle with its rotors' turbulence (`fixtures/compiled_flights.py`).
"""

from __future__ import annotations

import pytest

import alula
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle
from fixtures.compiled_flights import compiled_flights

ONE_AXIS = ("line:laps=3,ramp=1", "line:laps=4,ramp=1,size=0.8", "line:laps=3,ramp=1,size=1.2")
SIX_AXES = ("line:laps=3,ramp=1", "yaw_spin:laps=3,ramp=1", "Lemniscate:laps=4,ramp=1.5,speed=0.9")
FALSE_INERTIA = "seed 601: 1.14 +- 0.05 about y, of 20 seeds; the equations' low-passed rows know the future"
LAG = EffectUse("motor_lag", {"time_constant": 0.03})


@pytest.mark.slow  # forty diagnoses
@pytest.mark.parametrize(
    "manoeuvres",
    [
        pytest.param(ONE_AXIS, id="one axis", marks=pytest.mark.xfail(strict=True, reason=FALSE_INERTIA)),
        pytest.param(SIX_AXES, id="six axes"),
    ],
)
def test_the_answer_to_turbulence_is_no_inertia(arpl_250g: Vehicle, manoeuvres: tuple[str, ...]) -> None:
    vehicle = arpl_250g.with_effects(LAG)
    named = {}
    for seed in range(600, 620):
        flights = compiled_flights(
            vehicle, [LAG], catalogue=CATALOGUE, seed=seed, noise=2.0, commands=True, manoeuvres=manoeuvres
        )
        report = alula.diagnose(flights, vehicle).report
        named[seed] = {effect.name for effect in report.effects}
    assert {seed: names for seed, names in named.items() if "inertia" in names} == {}
