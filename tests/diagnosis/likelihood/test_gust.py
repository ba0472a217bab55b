"""A gust is told by slow force that is larger than the same turbulence's fast one, and by nothing else's."""

import numpy as np
import pytest

from diagnosis.likelihood import priors
from diagnosis.likelihood.gust import SlowForce, gust_in, gust_of
from diagnosis.likelihood.identify import identify
from diagnosis.likelihood.left_over import left_over
from diagnosis.noise.component import LogNormal
from dynamics.effects import CATALOGUE
from tests.diagnosis.likelihood.flights import problem_of

EFFECT = CATALOGUE["gust"]
NAMED = 3.0


def slow(level, fast, other=None, slope=0.3, fast_std=0.15):
    return SlowForce(level, 0.15, fast, fast_std, slope, other)


def test_the_harder_it_pushes_the_surer_it_is_with_the_intensity_that_drag_makes_of_it():
    gusts = [gust_of(EFFECT, [slow(0.3 * intensity, 0.01)]) for intensity in (0.03, 0.1, 0.4, 1.5)]
    odds = [gust.log_odds for gust in gusts]
    assert odds == sorted(odds)
    assert odds[0] < NAMED < odds[2]
    for gust, intensity in zip(gusts[2:], (0.4, 1.5), strict=True):
        assert abs(gust.intensity - intensity) < 2 * gust.std
        assert 0.1 < gust.std / gust.intensity < 0.25


@pytest.mark.parametrize("size", [0.001, 0.03, 1.0])
@pytest.mark.parametrize("ratio", [0.3, 0.8, 2.0])
def test_slow_force_about_as_large_as_the_fast_one_is_none(size, ratio):
    assert gust_of(EFFECT, [slow(ratio * size, size)]).log_odds < NAMED


def test_what_an_estimator_lets_drift_or_a_function_leaves_is_none():
    drift = LogNormal(priors.DRIFT.median * 1.2, priors.DRIFT.spread)
    assert gust_of(EFFECT, [slow(0.34, 0.01, slope=1.2)]).log_odds > NAMED
    assert gust_of(EFFECT, [slow(0.34, 0.01, drift, slope=1.2)]).log_odds < NAMED
    assert gust_of(EFFECT, [slow(3.4, 0.01, drift, slope=1.2)]).log_odds > NAMED  # more than any drifts
    assert gust_of(EFFECT, [slow(0.07, 0.004, LogNormal(0.3 * 0.2, 1.0))]).log_odds < NAMED


def test_a_fast_force_of_which_only_its_largest_size_is_known_hides_no_gust():
    """Beneath a gust the fast level's logarithm has a deviation of more than one."""
    sure, unsure = (gust_of(EFFECT, [slow(0.1, 0.01, fast_std=std)]) for std in (0.15, 1.4))
    assert NAMED < unsure.log_odds < sure.log_odds
    assert gust_of(EFFECT, [slow(0.02, 0.01, fast_std=1.4)]).log_odds < NAMED


def test_flights_of_two_kinds_of_logs_tell_one_gust_more_surely():
    one, other = slow(0.08, 0.01), slow(0.09, 0.01)
    together = gust_of(EFFECT, [one, other])
    assert together.log_odds > max(gust_of(EFFECT, [each]).log_odds for each in (one, other))
    assert together.std < gust_of(EFFECT, [one]).std


def test_levels_drawn_from_a_gust_are_within_their_interval():
    random, inside, count = np.random.default_rng(1), 0, 60
    for _ in range(count):
        intensity, ratio = np.exp(random.normal(np.log(0.5), 0.8)), np.exp(random.normal(np.log(0.8), 0.6))
        level = np.hypot(ratio * 0.01, 0.3 * intensity) * np.exp(random.normal(0, 0.15))
        gust = gust_of(EFFECT, [slow(level, 0.01)])
        inside += abs(gust.intensity - intensity) < 1.96 * gust.std
    assert inside >= 0.85 * count


def test_flights_in_still_air_have_none_and_a_catalogue_without_one_asks_for_none():
    problem = problem_of("nothing", "speeds", 90002)
    result = identify([problem])
    left = left_over(result)
    gust = gust_in(result.problems, left)
    assert gust is not None
    assert gust.log_odds < 0
    problem.catalogue = {name: effect for name, effect in CATALOGUE.items() if name != "gust"}
    assert gust_in([problem], left) is None
