"""The pursuit adds what leaves least in the full model, whatever the columns score highest."""

from types import SimpleNamespace

import pytest

from diagnosis.estimation import pursuit
from diagnosis.selection.search import IMPOSSIBLE
from diagnosis.thresholds import DEFAULT

SCORES = {"sensor": 9.0, "drag": 8.0, "damping": 7.0, "lift": 6.0, "wall": 5.0, "inflow": 4.0, "weak": 3.0}
LEFT = {  # reduced chi-square of the joint fits
    frozenset({"sensor"}): 40.0,
    frozenset({"drag"}): 9.0,
    frozenset({"drag", "damping"}): 3.0,
    frozenset({"drag", "damping", "lift"}): 1.01,
}


def candidate(name, fitted=None):
    return SimpleNamespace(key=name, fitted=fitted)


class Regression:
    def __init__(self, fitted=()):
        self.candidates = tuple(candidate(name, fitted=name if name in fitted else None) for name in SCORES)
        self.nuisances, self.thresholds, self.explained = (), DEFAULT, DEFAULT.search.explained

    def in_gust(self, variance):
        return self


@pytest.fixture
def fits(monkeypatch):
    """Every set that was fitted, in order."""
    tried = []

    class Search:
        thresholds = DEFAULT.search

        def __init__(self, regression):
            self.regression = regression

        def scores(self, sets):
            impossible = {"weak"}
            return [
                SimpleNamespace(candidates=s, score=IMPOSSIBLE if s[-1].key in impossible else SCORES[s[-1].key])
                for s in sets
            ]

    def fit(regression, candidates, start=None, level=None, goal=None):
        keys = frozenset(c.key for c in candidates)
        tried.append(keys)
        return SimpleNamespace(keys=keys, chi_square=LEFT.get(keys, 50.0), values={}, unsettled=frozenset())

    monkeypatch.setattr(pursuit, "Search", Search)
    monkeypatch.setattr(pursuit, "fit", fit)
    monkeypatch.setattr(pursuit, "about", lambda regression, own, nuisances, fitted: Regression(fitted.keys))
    monkeypatch.setattr(pursuit, "_exchanged", fit)
    return tried


def test_the_effect_that_leaves_least_is_added_until_little_is_left(fits):
    pursued = pursuit.pursue(Regression(), 0.0)
    assert {c.key for c in pursued.candidates} == {"drag", "damping", "lift"}


def test_a_few_of_the_highest_scores_are_fitted_and_none_that_is_impossible(fits):
    pursuit.pursue(Regression(), 0.0)
    first = [keys for keys in fits if len(keys) == 1]
    assert [next(iter(keys)) for keys in first] == list(SCORES)[: DEFAULT.search.max_proposed]


def test_it_ends_where_nothing_leaves_less(fits, monkeypatch):
    monkeypatch.setitem(LEFT, frozenset({"drag", "damping", "lift"}), 2.99)
    pursued = pursuit.pursue(Regression(), 0.0)
    assert {c.key for c in pursued.candidates} == {"drag", "damping"}
    assert all(fits.count(keys) == 1 for keys in fits if len(keys) == 3)  # the exchange changed nothing


def test_an_exchange_that_leaves_less_is_gone_on_from(fits, monkeypatch):
    monkeypatch.delitem(LEFT, frozenset({"drag", "damping", "lift"}))
    monkeypatch.setitem(LEFT, frozenset({"damping", "inflow"}), 2.0)
    monkeypatch.setitem(LEFT, frozenset({"damping", "inflow", "wall"}), 1.0)
    exchanged = [candidate("damping"), candidate("inflow")]
    monkeypatch.setattr(pursuit, "_exchanged", lambda regression, present: pursuit.fit(regression, exchanged))
    pursued = pursuit.pursue(Regression(), 0.0)
    assert {c.key for c in pursued.candidates} == {"damping", "inflow", "wall"}
