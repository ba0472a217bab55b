"""What no effect is races with the catalogue's: it is there where it was put, and only there."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

from diagnosis.likelihood.features import Discrepancy, Line, smooth, time_of
from diagnosis.likelihood.identify import Identified, identify
from diagnosis.likelihood.left_over import Left, left_over
from diagnosis.likelihood.lines import strongest_lines
from diagnosis.likelihood.noise_fit import likeliest, structures_of
from tests.diagnosis.likelihood.flights import problem_of

HIDDEN = {
    "nothing": ("nothing", "speeds", 90002),
    "linear_drag": ("single", "linear_drag", 90001),
    "swirl": ("outside", "swirl", 90001),
    "humming": ("outside", "humming", 90001),
}


@cache
def answer(name: str) -> tuple[Identified, tuple[Left, ...]]:
    """The effects of flights that hide a force or torque of the outside simulator, an effect, or nothing; and what is
    left."""
    result = identify([problem_of(*HIDDEN[name], 4)])
    return result, left_over(result).left


@pytest.mark.parametrize("name", ["nothing", pytest.param("linear_drag", marks=pytest.mark.slow)])
def test_where_the_catalogue_has_all_nothing_is_left(name):
    result, left = answer(name)
    assert left == ()
    named = [result.search.what.all[i].effect.name for i in result.best.members]
    assert named == ([] if name == "nothing" else [name])


@pytest.mark.slow
def test_a_force_that_stands_in_the_room_is_one_of_the_place():
    _, left = answer("swirl")
    placed = [one for one in left if one.discrepancy.of.kind == "place"]
    assert placed
    assert placed[0].channel < 3
    assert placed[0].log_odds > 10.0


def test_a_torque_of_one_frequency_is_a_line():
    _, (first, *_) = answer("humming")
    assert isinstance(first.discrepancy.of, Line)
    assert first.discrepancy.tried > 1000  # frequencies, each of which may be one by chance
    assert first.channel in (3, 4)
    course = first.parts[0]
    waves = np.abs(np.fft.rfft(course * np.hanning(len(course)), 16 * len(course)))
    frequency = np.fft.rfftfreq(16 * len(course), first.rows[0].period)[waves.argmax()]
    assert frequency == pytest.approx(first.discrepancy.of.frequency, abs=0.05)


def test_a_discrepancy_beside_which_effects_are_asked_is_a_nuisance():
    """The same torque beside a line of it: nothing of it is left for an effect, nor for the noise."""
    result, left = answer("humming")
    problems = [one.with_discrepancies([each.discrepancy for each in left]) for one in result.problems]
    again = identify(problems, begin=result.noise)
    assert again.best.members == ()
    torque = [name for name in again.noise[0].values if name.startswith("turbulence.torque_xy")]
    assert all(again.noise[0].values[name] < result.noise[0].values[name] for name in torque)


def test_a_line_is_found_where_it_is_and_of_its_size():
    problem = problem_of("nothing", "speeds", 90002, 3)
    noise = likeliest(problem, structures_of(problem.flights[0].segment))
    usual = [1.0] * 3 + [5.0] * 3
    assert strongest_lines(problem, noise.gain, usual) == []
    shaken = [
        dataclasses.replace(rows, force=rows.force + 0.3 * np.cos(2 * np.pi * 7.3 * time_of(rows))[:, None] * [1, 0, 0])
        for rows in problem.flights
    ]
    (line,) = strongest_lines(dataclasses.replace(problem, flights=shaken), noise.gain, usual)
    assert line.frequency == pytest.approx(7.3, abs=0.05)
    assert line.channel == 0


def test_functions_have_the_deviation_that_they_are_given():
    problem = problem_of("nothing", "speeds", 90002)
    flights = [(rows, problem.along(place)) for place, rows in enumerate(problem.flights)]
    random = np.random.default_rng(0)
    for kind in ("state", "velocity", "place", "time"):
        functions = smooth(kind, flights, fineness=1.5, count=30, seed=0)
        assert functions is not None
        one = Discrepancy(functions, 1, 0.4)
        drawn = [
            np.concatenate([one.of.along(*flight) for flight in flights])
            @ (one.deviations * random.standard_normal(30))
            for _ in range(200)
        ]
        assert np.sqrt(np.mean(np.square(drawn))) == pytest.approx(0.4, rel=0.2)
        np.testing.assert_allclose(np.mean(drawn, axis=1), 0.0, atol=1e-9)


def test_a_force_by_place_stands_in_the_world_and_one_by_velocity_turns_with_the_body():
    problem = problem_of("nothing", "speeds", 90002, 1)
    rows, along = problem.flights[0], problem.along(0)
    values = np.ones((len(rows), 1))
    for kind, expected in (("place", along.rotation[:, 0, :]), ("velocity", np.tile([1.0, 0.0, 0.0], (len(rows), 1)))):
        functions = smooth(kind, [(rows, along)], fineness=1.0, count=1, seed=0)
        acting = np.zeros((len(rows), 6, 1))
        Discrepancy(functions, 0, 1.0).act(acting, values, along)
        np.testing.assert_allclose(acting[:, :3, 0], expected)
        assert not acting[:, 3:].any()
