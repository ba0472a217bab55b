"""The log score on held-out flights: a density, higher with what is there, blind to what is each flight's own."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

from diagnosis.data.segment import Segment
from diagnosis.likelihood.flight_rows import make_rows
from diagnosis.likelihood.held_out_score import FlightScore, HeldOutScore, held_out_score
from diagnosis.likelihood.identify import Identified, identify
from diagnosis.report import score_sentence
from tests.diagnosis.likelihood.flights import flown, problem_of

DRAW = ("single", "rotor_drag", 90000)


@cache
def identified() -> tuple[Identified, tuple[Segment, ...]]:
    """A hidden drag that three flights name, and the flights that were held out."""
    return identify([problem_of(*DRAW, 3)], ["filtered pose"]), flown(*DRAW)[1].held_out


def scored(segments: tuple[Segment, ...] | None = None, result: Identified | None = None) -> HeldOutScore:
    """With the best set."""
    own, held_out = identified()
    made = held_out_score(result or own, own.best.members, segments or held_out)
    assert made is not None
    return made


def test_an_effect_that_is_there_raises_the_score_beyond_chance() -> None:
    result, held_out = identified()
    score = scored()
    assert [result.problems[0].what.all[i].key for i in result.best.members] == ["rotor_drag"]
    assert score.after - score.before == pytest.approx(score.gain)
    assert score.gain > 2 * score.gain_std > 0
    assert sum(s.duration for s in held_out) - 3.0 < score.seconds < sum(s.duration for s in held_out)


def test_the_noise_holds_on_a_held_out_flight_that_is_flown_as_the_fitted_ones() -> None:
    gentle = min(identified()[1], key=lambda s: float(np.abs(s.body_rate).max()))
    assert scored((gentle,)).chi_square == pytest.approx(1.0, abs=0.1)


def test_nothing_is_gained_where_nothing_is_named() -> None:
    result, held_out = identified()
    score = held_out_score(result, (), held_out)
    assert score is not None
    assert (score.before, score.gain, score.gain_std) == (score.after, 0.0, 0.0)


@pytest.mark.parametrize("factor", [0.5, -0.5])
def test_a_wrong_value_lowers_the_score(factor: float) -> None:
    result, held_out = identified()
    search = copy.copy(result.search)
    right = search.named_values
    wrong = {"named_values": lambda one: {i: {k: factor * v for k, v in own.items()} for i, own in right(one).items()}}
    vars(search).update(wrong)
    for segment in held_out:
        mistaken, score = scored((segment,), replace(result, search=search)), scored((segment,))
        assert mistaken.before == score.before
        assert mistaken.after < score.after
        assert (mistaken.gain > 0) is (factor > 0)


def test_the_bias_of_a_held_out_flights_gyro_counts_against_no_model() -> None:
    _, held_out = identified()
    bias = np.array([0.01, -0.01, 0.01])  # rad/s, as large as healthy sensors have
    biased = tuple(replace(s, gyro=None if s.gyro is None else s.gyro + bias) for s in held_out)
    plain, score = scored(), scored(biased)
    assert abs(score.after - plain.after) * score.seconds < 10.0  # nats; where it is not integrated out it costs 150
    assert score.gain == pytest.approx(plain.gain, rel=0.02)
    assert score.chi_square == pytest.approx(plain.chi_square, rel=0.02)


def test_the_score_is_the_density_of_all_readings_where_nuisances_are_integrated_out() -> None:
    """As one long Gaussian vector of whitened innovations: the textbook's answer."""
    result, held_out = identified()
    short = held_out[0].between(0, int(3.5 * held_out[0].rate))
    problem, gain = result.problems[0].of([make_rows(short, 0)]), result.noise[0].gain
    problem.move_to({}, {})
    flight = FlightScore(problem, gain, [0])
    parts = [flat for flat, _ in flight.parts(0)]
    total, count = np.eye(sum(map(len, parts))), 0
    std = np.array([one.std for one in problem.what.nuisances])
    of_blocks = np.array([one.lasts == "block" for one in problem.what.nuisances])
    lasting = np.concatenate(parts)[:, 1:][:, ~of_blocks] * std[~of_blocks]
    total += lasting @ lasting.T
    for part in parts:
        own = part[:, 1:][:, of_blocks] * std[of_blocks]
        total[count : count + len(part), count : count + len(part)] += own @ own.T
        count += len(part)
    nu = np.concatenate(parts)[:, 0]
    rotors = problem.vehicle.rotors.count
    others = np.linalg.slogdet(gain.V)[1] - np.linalg.slogdet(gain.V[-rotors:, -rotors:])[1]  # where speeds are given
    rows = count / (len(gain.V) - rotors)
    expected = stats.multivariate_normal.logpdf(nu, cov=total) - rows / 2 * others
    assert sum(block.log_score for block in flight.blocks()) == pytest.approx(expected, rel=1e-9)
    assert sum(block.squares for block in flight.blocks()) == pytest.approx(nu @ np.linalg.solve(total, nu), rel=1e-9)


def test_segments_that_no_filter_follows_have_no_score() -> None:
    result, held_out = identified()
    short = tuple(segment.between(0, int(0.9 * segment.rate)) for segment in held_out)
    assert held_out_score(result, (), short) is None
    other = tuple(replace(segment, specific_force=None) for segment in held_out)
    assert held_out_score(result, (), other) is None
    assert held_out_score(result, (), (*other, *held_out)) == held_out_score(result, (), held_out)


@pytest.mark.parametrize(
    ("gain", "words"), [(40.0, "better"), (-40.0, "worse"), (5.0, "no change beyond chance"), (0.0, "")]
)
def test_the_sentence_says_whether_the_score_rose_beyond_chance(gain: float, words: str) -> None:
    text = score_sentence(HeldOutScore(100.0, 100.0 + gain, gain, 10.0 if gain else 0.0, 1.02, 31.0))
    assert "31 s of held-out flight, chi-square 1.02" in text
    assert words in text
    assert ("before" in text) is bool(gain)
