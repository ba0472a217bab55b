"""Rounds of search and joint fit: columns are trusted where they are right alone, and a gust is judged there."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from diagnosis.data.dataset import make_dataset
from diagnosis.estimation import joint_search
from diagnosis.estimation.equation_error import fit
from diagnosis.estimation.joint_search import with_gust_about
from diagnosis.selection.regression_of_flights import make_regression
from diagnosis.selection.search import IMPOSSIBLE
from diagnosis.selection.selected import select, with_gust_by
from diagnosis.thresholds import DEFAULT
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse
from fixtures.rotorpy_flights import PATHS, rotorpy_flights

REGRESSION = SimpleNamespace(thresholds=DEFAULT)
LAST = SimpleNamespace(chi_square=25.0)
FAR = 13000.0  # reduced chi-square of a set many steps away


def selected_after(steps, chi_square, score=1.0):
    """A selection of as many effects as steps; a fit of it has this reduced chi-square."""
    chosen = SimpleNamespace(candidates=tuple(range(steps)), score=score)
    return SimpleNamespace(chosen=chosen, chi_square=chi_square)


@pytest.fixture
def rounds(monkeypatch):
    """What a search selects by its greatest number of steps, None for as many as it takes."""
    by_steps, tried = {}, []

    def select_from(regression, start, earlier, max_steps=None):
        tried.append(max_steps)
        return by_steps[max_steps]

    def fit(regression, candidates):
        return SimpleNamespace(
            chi_square=next(s.chi_square for s in by_steps.values() if s.chosen.candidates == candidates)
        )

    monkeypatch.setattr(joint_search, "select_from", select_from)
    monkeypatch.setattr(joint_search, "fit", fit)
    return by_steps, tried


def test_a_set_that_fits_far_worse_is_sought_again_with_fewer_steps(rounds):
    by_steps, tried = rounds
    by_steps |= {None: selected_after(8, FAR), 4: selected_after(4, 237.0), 2: selected_after(2, 24.0)}
    selection, fitted = joint_search._trusted(REGRESSION, (), None, LAST)
    assert selection is by_steps[2]
    assert fitted.chi_square == 24.0
    assert tried == [None, 4, 2]


def test_a_set_that_is_impossible_is_sought_again_too(rounds):
    by_steps, _ = rounds
    by_steps |= {None: selected_after(4, 24.0, IMPOSSIBLE), 2: selected_after(2, 24.5)}
    assert joint_search._trusted(REGRESSION, (), None, LAST)[0] is by_steps[2]


def test_noise_that_differs_a_little_from_round_to_round_stops_nothing(rounds):
    by_steps, tried = rounds
    by_steps |= {None: selected_after(8, 1.5 * LAST.chi_square)}
    assert joint_search._trusted(REGRESSION, (), None, LAST)[0] is by_steps[None]
    assert tried == [None]


AIR = {name: CATALOGUE[name] for name in ("rotor_drag", "parasitic_drag", "wind", "gust", "gyro_bias", "imu_bias")}
DRAGS = (EffectUse("rotor_drag", {"coefficient": 2e-5}), EffectUse("parasitic_drag", {"coefficient": 0.02}))
STEADY = EffectUse("wind", {"x": 2.5, "y": -1.5})


@pytest.fixture(scope="module")
def judged(arpl_250g):
    """The gust beside a steady wind that is fitted: about still air, and about the fit. By what else moves the air."""
    answers, vehicle = {}, arpl_250g.with_effects(*DRAGS)
    for intensity in (0.0, 0.6):
        hidden = [STEADY, *([EffectUse("gust", {"intensity": intensity})] if intensity else [])]
        paths = [PATHS[i] for i in (0, 1, 3, 7)]
        flights = rotorpy_flights(vehicle, hidden, seed=6, noise=0.3, paths=paths, duration=8.0)
        dataset = make_dataset(flights, vehicle)
        first = make_regression(vehicle, AIR, dataset.fitted, dataset.flight_of)
        wind = next(c for c in first.candidates if c.effect.name == "wind")
        selection, fitted = select(first), fit(first, [wind])
        others = replace(selection, chosen=replace(selection.chosen, candidates=()))
        about = with_gust_about(first, first, others, fitted)[1]
        answers[intensity] = with_gust_by(first, selection, [wind]), about, fitted
    return answers


def test_no_gust_is_beside_a_steady_wind_that_is_named_exactly(judged):
    about_still_air, about_the_fit, fitted = judged[0.0]
    assert fitted.estimates["wind", "x"].value == pytest.approx(2.5, rel=0.01)
    assert about_still_air.gust_detected  # what the square of the wind leaves
    assert not about_the_fit.gust_detected


def test_a_gust_beside_a_steady_wind_is_still_one(judged):
    _, about_the_fit, _ = judged[0.6]
    assert about_the_fit.gust_detected
    assert 0.4 < about_the_fit.gust.intensity < 1.2
