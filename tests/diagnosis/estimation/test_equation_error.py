"""A planted mass comes back from equation error, within its interval and its bounds."""

import numpy as np
import pytest

from diagnosis.estimation.equation_error import bounds, fit, with_candidates
from diagnosis.selection.regression import make_regression
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
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
