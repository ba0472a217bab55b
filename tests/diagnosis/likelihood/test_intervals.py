"""Values without bias, and intervals that know what the flights do not show."""

import numpy as np
import pytest

from dynamics.effects import CATALOGUE
from dynamics.effects.time_delay import SENSOR_PRIOR
from dynamics.vehicle import EffectUse
from fixtures.compiled_flights import compiled_flights
from fixtures.outside_cases import Campaign, captured_flights, flown, vehicle_of
from fixtures.outside_sensors import Recorder
from tests.diagnosis.set_fits import fitted_to

MANOEUVRES = ("line:plane=yx,laps=3,ramp=1,size=1.3", "Lemniscate:laps=4,ramp=1.5,speed=0.9")
LINES = (
    "line:plane=yx,laps=3,ramp=1,size=1.3",
    "line:laps=3,ramp=1",
    "line:plane=yx,laps=3,ramp=1",
    "Lemniscate:laps=4,ramp=1.5,speed=0.9",
)
RIGHT = EffectUse("inertia", {"ratio_x": 1.0, "ratio_y": 1.0, "ratio_z": 1.0})


@pytest.fixture(scope="module")
def in_turbulence(arpl_250g):
    """Ratios of inertia about x and y, 1 in truth, of commands in four times the usual turbulence."""
    vehicle = arpl_250g.with_effects(EffectUse("motor_lag", {"time_constant": 0.03}))
    flights = compiled_flights(vehicle, [], catalogue=CATALOGUE, seed=1, noise=4.0, commands=True, manoeuvres=LINES)
    estimates = fitted_to(flights, vehicle, RIGHT).estimates
    return [estimates["inertia", f"ratio_{axis}"] for axis in "xy"]


def test_the_interval_of_an_inertia_allows_for_commands_that_answer_turbulence(in_turbulence):
    for ratio in in_turbulence:
        assert ratio.value == pytest.approx(1.0, abs=2 * ratio.std)
        assert ratio.std < 0.2


@pytest.mark.xfail(strict=True, reason="1.26 about one axis by the likelihood, with a deviation of 0.13 to 0.2")
def test_commands_that_answer_turbulence_do_not_enlarge_the_inertia(in_turbulence):
    for ratio in in_turbulence:
        assert ratio.value == pytest.approx(1.0, abs=min(0.25, 2 * ratio.std))


def test_each_flight_has_a_clock_of_its_own_beside_the_delay_of_all(arpl_250g):
    late = EffectUse("time_delay", {"delay": 0.03})
    flights = compiled_flights(arpl_250g, [late], catalogue=CATALOGUE, seed=1, manoeuvres=MANOEUVRES)
    delay = fitted_to(flights, arpl_250g, late).estimates["time_delay", "delay"]
    assert delay.value == pytest.approx(0.03, abs=3 * delay.std)
    assert delay.std > 0.9 * SENSOR_PRIOR / np.sqrt(len(flights))


@pytest.mark.xfail(
    strict=True, reason="of speeds at 100 Hz the filter takes the rotors' acceleration for noise: 1.2e-7"
)
def test_a_rotors_inertia_comes_out_of_flights_that_another_simulator_flew():
    hidden = EffectUse("rotor_gyroscopic", {"inertia": 2e-6})
    campaign = Campaign(
        {hidden.name: dict(hidden.parameters)}, {}, Recorder(100.0, noise=0.3), False, False, 3, 8, duration=8.0
    )
    (truths,) = flown([campaign])
    fitted = fitted_to(captured_flights(campaign, truths), vehicle_of(campaign), hidden)
    assert fitted.estimates["rotor_gyroscopic", "inertia"].value == pytest.approx(2e-6, rel=0.02)
