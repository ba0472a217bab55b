"""Estimates without bias, and intervals that know what the flights do not show."""

import numpy as np
import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.estimation.equation_error import fit
from diagnosis.selection.regression_of_flights import make_regression
from dynamics.effects import CATALOGUE
from dynamics.effects.time_delay import SENSOR_PRIOR
from dynamics.vehicle import EffectUse
from fixtures.compiled_flights import compiled_flights
from fixtures.outside_cases import Campaign, captured_flights, flown, vehicle_of
from fixtures.outside_sensors import Recorder

MANOEUVRES = ("line:plane=yx,laps=3,ramp=1,size=1.3", "Lemniscate:laps=4,ramp=1.5,speed=0.9")
LINES = (
    "line:plane=yx,laps=3,ramp=1,size=1.3",
    "line:laps=3,ramp=1",
    "line:plane=yx,laps=3,ramp=1",
    "Lemniscate:laps=4,ramp=1.5,speed=0.9",
)
SENSORS = ("imu_bias", "gyro_bias", "time_delay")


def fitted(vehicle, flights, name, *others):
    """The estimates of an effect, by parameter, and the number of fitted flights."""
    data = make_dataset(flights, vehicle)
    some = {n: CATALOGUE[n] for n in (*SENSORS, name, *others)}
    regression = make_regression(vehicle, some, data.fitted, data.flight_of)
    family = [c for c in regression.candidates if c.effect.name == name]
    estimate = min((fit(regression, [c]) for c in family), key=lambda one: one.chi_square)
    return {parameter: e for (_, parameter), e in estimate.estimates.items()}, len(regression.flights)


def test_commands_that_answer_turbulence_do_not_enlarge_the_inertia(arpl_250g):
    vehicle = arpl_250g.with_effects(EffectUse("motor_lag", {"time_constant": 0.03}))
    flights = compiled_flights(vehicle, [], catalogue=CATALOGUE, seed=1, noise=4.0, commands=True, manoeuvres=LINES)
    estimates, _ = fitted(vehicle, flights, "inertia", "motor_lag")
    for ratio in (estimates["ratio_x"], estimates["ratio_y"]):
        assert ratio.value == pytest.approx(1.0, abs=min(0.25, 2 * ratio.std))


def test_what_the_age_of_the_commands_moves_is_in_the_interval(arpl_250g):
    """A lag of the vehicle file that is 3 ms off: as much as commands may be older than their rows at 100 Hz."""
    hidden = [EffectUse("motor_lag", {"time_constant": 0.03}), EffectUse("rotational_damping", {"coefficient": 5e-4})]
    manoeuvres = ("line:laps=3,ramp=1", "bob:laps=4,ramp=1,height=0.25", "Lemniscate:laps=4,ramp=1.5,speed=0.9")
    flights = compiled_flights(
        arpl_250g, hidden, catalogue=CATALOGUE, seed=3, noise=0.3, commands=True, manoeuvres=manoeuvres
    )
    right, late = (
        fitted(with_lag, flights, "rotational_damping", "motor_lag")[0]["coefficient"]
        for with_lag in (
            arpl_250g.with_effects(EffectUse("motor_lag", {"time_constant": lag})) for lag in (0.03, 0.033)
        )
    )
    assert right.value == pytest.approx(5e-4, abs=right.std)
    assert 0.5 * right.std < abs(late.value - right.value) < right.std


def test_each_flight_has_a_clock_of_its_own_beside_the_delay_of_all(arpl_250g):
    late = [EffectUse("time_delay", {"delay": 0.03})]
    flights = compiled_flights(arpl_250g, late, catalogue=CATALOGUE, seed=1, manoeuvres=MANOEUVRES)
    estimates, count = fitted(arpl_250g, flights, "time_delay")
    assert estimates["delay"].value == pytest.approx(0.03, abs=3 * estimates["delay"].std)
    assert estimates["delay"].std > 0.9 * SENSOR_PRIOR / np.sqrt(count)


def test_a_rotors_inertia_comes_out_of_flights_that_another_simulator_flew():
    hidden = {"rotor_gyroscopic": {"inertia": 2e-6}}
    campaign = Campaign(hidden, {}, Recorder(100.0, noise=0.3), False, False, 3, 8, duration=8.0)
    (truths,) = flown([campaign])
    estimates, _ = fitted(vehicle_of(campaign), captured_flights(campaign, truths), "rotor_gyroscopic")
    assert estimates["inertia"].value == pytest.approx(2e-6, rel=0.01)


def test_what_flights_do_not_show_of_the_ground_effect_is_in_its_interval(arpl_250g):
    radius = arpl_250g.rotors.disc_radius
    near = [EffectUse("ground_effect", {"gain": 2.0, "radius": radius})]
    low = ("low_flight:laps=2,ramp=1,height=0.3", "low_flight:laps=3,ramp=1,height=0.25", *MANOEUVRES)
    flights = compiled_flights(arpl_250g, near, catalogue=CATALOGUE, seed=3, manoeuvres=low)
    estimates, _ = fitted(arpl_250g, flights, "ground_effect")
    assert estimates["radius"].value == radius
    assert estimates["gain"].value == pytest.approx(2.0, rel=0.05)
    assert 0.3 < estimates["gain"].std / 2.0 < 1.5  # the radius is known to within half
