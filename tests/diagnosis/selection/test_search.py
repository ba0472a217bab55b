"""The search names a planted pair, and nothing where nothing is planted."""

import dataclasses

import msgspec
import numpy as np
import pytest

from diagnosis.models.pose_errors import PoseErrors
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.gust import Gust
from diagnosis.selection.search import IMPOSSIBLE, Search, _is_gust, min_score, possible, select
from diagnosis.thresholds import DEFAULT
from dynamics.effects import CATALOGUE
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, planted


def with_search(**fields):
    return msgspec.structs.replace(DEFAULT, search=msgspec.structs.replace(DEFAULT.search, **fields))


@pytest.mark.parametrize("seed", range(5))
def test_a_planted_pair_is_named_with_the_stronger_one_first(arpl_250g, seed):
    selection = select(planted(arpl_250g, [0.0, 0.3, 0.0, 0.2, 0.0], seed=seed))
    assert [c.key for c in selection.chosen.candidates] == ["b", "d"]
    assert not selection.gust_detected


@pytest.mark.parametrize("seed", range(20))
def test_where_nothing_is_planted_nothing_is_named(arpl_250g, seed):
    selection = select(planted(arpl_250g, [0.0] * 6, seed=seed))
    assert selection.chosen.candidates == ()
    assert len(selection.singles) == 6


def test_no_more_effects_are_named_than_the_threshold_allows(arpl_250g):
    everything = planted(arpl_250g, [0.3] * 12, seed=0)
    assert len(select(everything).chosen.candidates) == DEFAULT.search.max_effects
    two = planted(arpl_250g, [0.3, 0.3, 0.3, 0.3], seed=0, thresholds=with_search(max_effects=2))
    assert len(select(two).chosen.candidates) == 2


def test_the_least_score_decides_whether_an_effect_is_claimed(arpl_250g):
    score = select(planted(arpl_250g, [0.2, 0.0], seed=0)).chosen.score
    claimed = planted(arpl_250g, [0.2, 0.0], seed=0, thresholds=with_search(min_gain=score - 1))
    refused = planted(arpl_250g, [0.2, 0.0], seed=0, thresholds=with_search(min_gain=score + 1))
    assert select(claimed).chosen.names == {"a"}
    assert select(refused).chosen.names == set()
    assert min_score([candidate(CATALOGUE["gyro_bias"], 0, 1, 2)]) == DEFAULT.search.min_fault_gain


def test_a_score_is_the_gain_less_a_penalty_for_each_coefficient(arpl_250g):
    search = Search(planted(arpl_250g, [0.2, 0.0], seed=0))
    a, b = search.regression.candidates
    one, both = search.score([a]), search.score([a, b])
    assert one.gain - one.score == pytest.approx(search.penalty(a))
    assert both.gain - both.score == pytest.approx(2 * search.penalty(a))
    assert both.gain >= one.gain
    assert search.singles()[0].names == {"a"}


def test_a_coefficient_beyond_its_physical_bounds_is_impossible(arpl_250g):
    bounded = effect("bounded", bound=1.0)
    free = Candidate(bounded, None, {"size": 0.0}, ("size",), (0,))
    assert possible(free, np.array([1.01]), arpl_250g)  # within the noise's slack of 0.02 deviations
    assert not possible(free, np.array([1.05]), arpl_250g)
    search = Search(planted(arpl_250g, [12.0], seed=0))
    assert search.score(search.regression.candidates).score == IMPOSSIBLE


def test_a_fixed_shape_comes_with_its_own_size(arpl_250g):
    lag = CATALOGUE["motor_lag"]
    fixed = Candidate(lag, None, {"time_constant": 0.03}, (), (0,))
    assert fixed.fixed_shape
    assert possible(fixed, np.array([1.0]), arpl_250g)
    assert not possible(fixed, np.array([0.2]), arpl_250g)
    assert not possible(fixed, np.array([2.5]), arpl_250g)
    short = Candidate(lag, None, {"time_constant": 0.002}, (), (0,))
    assert not possible(
        short, np.array([1.0]), arpl_250g
    )  # shorter than the least detectable, which clock offsets hide


def test_air_motion_within_the_estimators_own_error_is_no_gust(arpl_250g):
    of_all = planted(arpl_250g, [0.0], seed=0)
    estimated = dataclasses.replace(of_all, pose=PoseErrors(np.ones(CHANNELS), 0.2))
    weak, strong = (Gust(100.0, 90.0, intensity) for intensity in (0.15, 0.4))
    assert _is_gust(weak, of_all, 40.0)
    assert not _is_gust(weak, estimated, 40.0)
    assert _is_gust(strong, estimated, 40.0)
    assert not _is_gust(strong, estimated, 95.0)
