"""Rounds of search and joint fit: a set that was selected too far from where the columns are right is not trusted."""

from types import SimpleNamespace

import pytest

from diagnosis.estimation import joint_search
from diagnosis.selection.search import IMPOSSIBLE
from diagnosis.thresholds import DEFAULT

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
