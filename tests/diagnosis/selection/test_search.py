"""The search names a planted pair, and nothing where nothing is planted."""

import dataclasses

import msgspec
import numpy as np
import pytest

from diagnosis.models.pose_errors import PoseErrors
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.coefficients import possible
from diagnosis.selection.gust import Gust
from diagnosis.selection.search import IMPOSSIBLE, Search, min_score
from diagnosis.selection.selected import _is_gust, select
from diagnosis.thresholds import DEFAULT
from dynamics.effects import CATALOGUE
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, planted, regression


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
    weak, strong = (Gust(100.0, 90.0, intensity, 0.02, 1.0) for intensity in (0.15, 0.8))
    assert _is_gust(weak, of_all, 40.0)
    assert not _is_gust(weak, estimated, 40.0)
    assert _is_gust(strong, estimated, 40.0)
    assert not _is_gust(strong, estimated, 95.0)
    fast = dataclasses.replace(strong, corner=0.3)  # spreads its strength over more frequencies than the error
    assert _is_gust(fast, of_all, 40.0)
    assert not _is_gust(fast, estimated, 40.0)


def test_a_gust_that_few_resamples_show_or_whose_interval_holds_nothing_is_none(arpl_250g):
    of_all = planted(arpl_250g, [0.0], seed=0)
    assert _is_gust(Gust(100.0, 90.0, 0.4, 0.1, 0.6), of_all, 40.0)
    assert not _is_gust(Gust(100.0, 90.0, 0.4, 0.25, 0.6), of_all, 40.0)
    assert not _is_gust(Gust(100.0, 90.0, 0.4, 0.1, 0.4), of_all, 40.0)


def mixture(vehicle, *, seed, columns_of, theta, flights=6, rows=80, bound=10.0):
    """A regression on columns made of random ones by columns_of; theta of the random ones are in the rows."""
    random = np.random.default_rng(seed)
    pure = [random.standard_normal((rows, CHANNELS, len(theta))) for _ in range(flights)]
    residuals = [x @ np.array(theta) + random.standard_normal((rows, CHANNELS)) for x in pure]
    columns = [columns_of(x) for x in pure]
    candidates = [candidate(effect(chr(ord("a") + i), bound=bound), i) for i in range(columns[0].shape[2])]
    return regression(vehicle, candidates, columns, residuals)


def test_an_effect_that_looks_like_two_is_exchanged_for_them(arpl_250g):
    def with_sum(x):
        return np.concatenate([x @ np.array([[1.0], [1.0], [0.3]]), x[:, :, :2]], axis=2)

    both = mixture(arpl_250g, seed=0, columns_of=with_sum, theta=[0.35, 0.25, 0.0])
    assert Search(both).singles()[0].names == {"a"}
    assert select(both).chosen.names == {"b", "c"}


def test_two_effects_that_share_the_work_of_one_are_merged(arpl_250g):
    def with_halves(x):
        z, n = x[:, :, :1], x[:, :, 1:]
        return np.concatenate([z + n, z - n, z], axis=2)

    one = mixture(arpl_250g, seed=1, columns_of=with_halves, theta=[0.4, 0.0])
    search = Search(one)
    a, b, c = one.candidates
    halves = search.score([a, b])
    assert halves.gain == pytest.approx(search.score([c]).gain, rel=0.01)
    assert search.better(halves).names == {"c"}


@pytest.mark.parametrize(("rest", "named"), [(0.1, {"a"}), (0.35, {"whole"})])
def test_an_effect_gives_way_to_a_part_of_it_where_the_rest_is_no_effect_by_itself(arpl_250g, rest, named):
    random = np.random.default_rng(5)
    columns = [random.standard_normal((80, CHANNELS, 2)) for _ in range(6)]
    residuals = [x @ np.array([4.0, rest]) + random.standard_normal((80, CHANNELS)) for x in columns]
    candidates = [candidate(effect("a"), 0), candidate(effect("whole", parameters=("z", "rest")), 0, 1)]
    of_both = regression(arpl_250g, candidates, columns, residuals)
    gains = [Search(of_both).score([one]).gain for one in candidates]
    assert gains[0] > DEFAULT.search.parsimony * gains[1]
    assert select(of_both).chosen.names == named


def test_a_set_with_an_impossible_effect_is_tried_without_it(arpl_250g):
    tight = mixture(arpl_250g, seed=2, columns_of=lambda x: x, theta=[0.3, 2.0], bound=1.0)
    search = Search(tight)
    a, b = tight.candidates
    assert search.score([a, b]).score == IMPOSSIBLE
    assert [scored.names for scored in search.possible_scores([(a, b)])] == [{"a"}]


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_best_effect_contends_with_itself_whatever_share_of_its_score_a_contender_needs(arpl_250g, share):
    thresholds = with_search(min_contender_share=share)
    search = Search(planted(arpl_250g, [0.2, 0.0, 0.3], seed=0, thresholds=thresholds))
    assert search.first(search.singles()).names == {"c"}


def test_every_step_of_the_search_raises_what_it_maximises(arpl_250g):
    search = Search(planted(arpl_250g, [0.3, 0.0, 0.2, 0.0, 0.25, 0.15], seed=3))
    chosen, worths = search.score([search.regression.candidates[1]]), []
    while chosen is not None:
        worths.append(search.worth(chosen))
        last, chosen = chosen, search.better(chosen)
    assert last.names == {"a", "c", "e", "f"}
    assert worths == sorted(set(worths))


@pytest.mark.parametrize("count", [9, 12])
def test_many_effects_are_named_up_to_the_greatest_number(arpl_250g, count):
    theta = [0.3] * count + [0.0] * 6
    chosen = select(planted(arpl_250g, theta, seed=4)).chosen
    assert len(chosen.candidates) == min(count, DEFAULT.search.max_effects)
    assert {int(c.columns[0]) for c in chosen.candidates} <= set(range(count))
