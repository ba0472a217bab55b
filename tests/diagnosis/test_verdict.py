"""The verdict is `unknown` where a test of the residuals rejects, else that of the effects."""

import numpy as np
import pytest

from diagnosis.report import MissingEffect
from diagnosis.selection.residual_tests import ResidualTests
from diagnosis.selection.search import Scored, Search
from diagnosis.verdict import channel_errors, judge, not_excited
from tests.diagnosis.synthetic import CHANNELS, candidate, effect, planted, regression

CLEAN = ResidualTests(1.0, 0.0, 2.0, 0.0)
ALONE = MissingEffect("a", None, {}, 1.0, ())
AMBIGUOUS = MissingEffect("a", None, {}, 1.0, ("b",))


def verdict(effects=(), after=CLEAN, before=CLEAN, chi_squares=(1.0, 1.0), gust_share=0.0, gusty=False):
    return judge(effects, after, before, chi_squares, gust_share, gusty=gusty)


def test_clean_residuals_leave_the_verdict_to_the_effects():
    assert verdict() == "explained"
    assert verdict([ALONE]) == "effect"
    assert verdict([AMBIGUOUS]) == "ambiguous"


@pytest.mark.parametrize(
    "after",
    [ResidualTests(6.0, 0.0, 2.0), ResidualTests(1.0, 0.02, 2.0), ResidualTests(1.0, 0.0, 11.0)],
    ids=["agreement", "state", "line"],
)
def test_a_residual_test_that_rejects_makes_it_unknown(after):
    assert verdict([ALONE], after=after) == "unknown"
    assert verdict(after=after) == "unknown"


def test_a_typical_window_that_stays_far_above_the_noise_makes_it_unknown():
    assert verdict([ALONE], chi_squares=(4.0, 1.6)) == "unknown"
    assert verdict([ALONE], chi_squares=(4.0, 1.4)) == "effect"
    assert verdict([ALONE], chi_squares=(100.0, 2.0)) == "effect"  # a small share of what there was


def test_a_small_share_of_what_there_was_is_the_effects_own_form():
    strong = ResidualTests(300.0, 1.0, 2.0)
    assert verdict([ALONE], after=ResidualTests(8.0, 0.02, 2.0), before=strong) == "effect"


def test_beside_a_swinging_load_only_a_strong_line_counts():
    assert verdict([ALONE], after=ResidualTests(1.0, 0.0, 20.0), chi_squares=None) == "effect"
    assert verdict([ALONE], after=ResidualTests(1.0, 0.0, 40.0), chi_squares=None) == "unknown"


def test_a_gust_may_leave_residuals_unless_state_or_place_predict_them():
    slow = ResidualTests(20.0, 0.0, 2.0)
    assert verdict([ALONE], after=slow, gust_share=1.0, gusty=True) == "effect"
    assert verdict([ALONE], after=ResidualTests(20.0, 0.5, 2.0), gust_share=1.0, gusty=True) == "unknown"
    assert verdict([ALONE], after=ResidualTests(20.0, 0.0, 2.0, 0.5), gust_share=1.0, gusty=True) == "unknown"


def test_an_effect_whose_signal_is_too_small_was_not_excited(arpl_250g):
    random = np.random.default_rng(0)
    columns = [random.standard_normal((80, CHANNELS, 3)) * np.array([1.0, 1.0, 0.01]) for _ in range(6)]
    rows = [0.5 * x[:, :, 0] + random.standard_normal((80, CHANNELS)) for x in columns]
    candidates = [candidate(effect(name), i) for i, name in enumerate(("there", "absent", "quiet"))]
    of_all = regression(arpl_250g, candidates, columns, rows)
    chosen = Search(of_all).score([candidates[0]])
    assert not_excited(of_all, chosen) == ("quiet",)
    assert not_excited(of_all, Scored((), 0.0, 0.0)) == ("quiet",)


def test_channel_errors_are_norms_over_the_three_axes(arpl_250g):
    of_all = planted(arpl_250g, [0.0], seed=0)
    errors = channel_errors([np.full((50, CHANNELS), 2.0)], [np.ones((50, CHANNELS))], of_all, of_all.noise.floor)
    assert errors["imu"].before == pytest.approx(2 * np.sqrt(3))
    assert errors["mocap"].after == pytest.approx(np.sqrt(3))
    assert errors["angular"].floor == pytest.approx(np.sqrt(3))
