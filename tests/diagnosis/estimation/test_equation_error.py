"""A planted mass comes back from equation error, within its interval and its bounds."""

import numpy as np
import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.estimation.equation_error import _EquationErrorProblem, fit
from diagnosis.estimation.fitted import bounds, with_candidates
from diagnosis.selection.regression_of_flights import make_regression
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.compiled_flights import compiled_flights
from tests.diagnosis.synthetic import hovering

SOME = {name: CATALOGUE[name] for name in ("mass", "imu_bias", "gyro_bias")}
RATIO = 1.05


@pytest.fixture(scope="module")
def of_heavy(arpl_250g):
    segments = hovering(arpl_250g, mass_ratio=RATIO, seed=4, count=3)
    return make_regression(arpl_250g, SOME, segments, range(3))


def of(regression, name):
    return next(c for c in regression.candidates if c.effect.name == name)


def test_a_planted_mass_comes_back_within_its_interval(of_heavy):
    fitted = fit(of_heavy, [of(of_heavy, "mass")])
    estimate = fitted.estimates["mass", "ratio"]
    assert estimate.value == pytest.approx(RATIO, abs=4 * estimate.std)
    assert 0 < estimate.std < 0.005
    assert estimate.unit == "1"
    assert fitted.vehicle.effects[0] == EffectUse("mass", {"ratio": estimate.value})


def test_the_interval_is_about_the_spread_over_flights(arpl_250g):
    estimates = []
    for seed in range(8):
        one = make_regression(arpl_250g, SOME, hovering(arpl_250g, mass_ratio=RATIO, seed=seed), [0])
        estimates.append(fit(one, [of(one, "mass")]).estimates["mass", "ratio"])
    spread = np.std([e.value for e in estimates])
    assert 0.3 < spread / np.mean([e.std for e in estimates]) < 2.0


def test_nothing_to_fit_leaves_the_vehicle_as_it_is(of_heavy):
    fitted = fit(of_heavy, [])
    assert fitted.vehicle is of_heavy.vehicle
    assert fitted.estimates == {}


def test_a_candidate_takes_the_place_of_the_files_effect_of_the_same_name(arpl_250g, of_heavy):
    vehicle = arpl_250g.with_effects(EffectUse("mass", {"ratio": 1.2}), EffectUse("rotor_drag", {"coefficient": 1e-5}))
    changed = with_candidates(vehicle, [of(of_heavy, "mass")], {"mass.ratio": 1.1})
    assert {use.name: dict(use.parameters) for use in changed.effects} == {
        "rotor_drag": {"coefficient": 1e-5},
        "mass": {"ratio": 1.1},
    }


def test_bounds_are_the_effects_own():
    parameter = CATALOGUE["mass"].parameters[0]
    assert bounds(CATALOGUE["mass"], "ratio") == (parameter.lower, parameter.upper)


def test_a_fit_that_was_made_is_not_made_again(of_heavy, arpl_250g):
    mass = of(of_heavy, "mass")
    assert fit(of_heavy, [mass]) is fit(of_heavy, [mass], vehicle=arpl_250g)
    assert fit(of_heavy, [mass]) is not fit(of_heavy, [mass], start={("mass", "ratio"): 1.2})
    biased = arpl_250g.with_effects(EffectUse("gyro_bias", {"x": 0.02, "y": 0.0, "z": 0.0}))
    assert fit(of_heavy, [mass], vehicle=biased).vehicle.effects != fit(of_heavy, [mass]).vehicle.effects


def regressed(vehicle, flights, *names):
    data = make_dataset(flights, vehicle)
    some = {name: CATALOGUE[name] for name in ("imu_bias", "gyro_bias", "time_delay", *names)}
    return make_regression(vehicle, some, data.fitted, data.flight_of)


def test_the_normal_equations_lose_what_a_step_explains_noise_in_the_columns_included(arpl_250g):
    """What noise adds to Z'y is less by what it adds to Z'X, else a fit depends on where it began."""
    manoeuvres = ("line:laps=3,ramp=1", "Lemniscate:laps=4,ramp=1.5,speed=0.9")
    flights = compiled_flights(arpl_250g, [], catalogue=CATALOGUE, seed=3, noise=4.0, manoeuvres=manoeuvres)
    regression = regressed(arpl_250g, flights, "rotational_damping")
    damping = of(regression, "rotational_damping")
    problem, key = _EquationErrorProblem(regression, [damping], arpl_250g), "rotational_damping.coefficient"
    here, there = (problem._equations({key: value}) for value in (0.0, 1e-3))
    for gram, before, after in zip(here.grams, here.products, there.products, strict=True):
        assert before[0] - after[0] == pytest.approx(1e-3 * gram[0, 0], rel=1e-6)


def test_a_channel_that_the_model_misses_does_not_change_what_the_others_show(arpl_250g):
    """Moments of a weak rotor that nobody fits, by commands: the lag is that of the thrust."""
    hidden = [
        EffectUse("motor_lag", {"time_constant": 0.03}),
        EffectUse("weak_rotor", {"loss": 0.12, "torque_loss": 0.12}, 0),
    ]
    manoeuvres = ("line:laps=3,ramp=1", "bob:laps=4,ramp=1,height=0.25", "Lemniscate:laps=4,ramp=1.5,speed=0.9")
    flights = compiled_flights(
        arpl_250g, hidden, catalogue=CATALOGUE, seed=3, noise=0.5, commands=True, manoeuvres=manoeuvres
    )
    regression = regressed(arpl_250g, flights, "motor_lag", "weak_rotor")
    fitted = fit(regression, [of(regression, "motor_lag")])
    assert fitted.chi_square > 100  # of the noise that the fit with the rotor leaves
    assert fitted.estimates["motor_lag", "time_constant"].value == pytest.approx(0.03, abs=0.002)
