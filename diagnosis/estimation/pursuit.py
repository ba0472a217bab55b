"""Orthogonal matching pursuit (Pati, Rezaiifar and Krishnaprasad, 1993) in which the full model decides each step.

Columns are linear about one fit. Where much is missing what they select may stand for others, and the further a search
goes by them the further it leads astray. Here they only propose: each of the effects with the highest scores is fitted
jointly with all before, the one that leaves least is added, and all columns are made again about that fit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from diagnosis.estimation.alternatives import decided_rivals, merged_pairs, on_decided_rotors
from diagnosis.estimation.equation_error import fit
from diagnosis.estimation.fitted import Fit
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.selection.regression_of_flights import about_fit
from diagnosis.selection.search import IMPOSSIBLE, Search, Set


@dataclass(frozen=True, eq=False)
class Pursued:
    """Where the pursuit has led.

    regression: about the fit of the candidates, in still air. candidates: of it.
    """

    regression: Regression
    candidates: Sequence[Candidate]


def pursue(regression: Regression, gust_variance: float) -> Pursued | None:
    """The effects to which the full model leads, one by one, from none; None where it leads to none.

    Where no further one leaves less by what counts, the full model exchanges rotors, pairs and rivals, and it goes on
    from there. gust_variance: of the air beside them, (m/s)^2.
    """
    limits, own, nuisances = regression.thresholds, regression.candidates, regression.nuisances
    last: Fit | None = None
    at, tried = Pursued(regression, ()), set[frozenset[str]]()
    while last is None or last.chi_square > regression.explained:
        here = at.regression.in_gust(gust_variance)
        best = _best_addition(here, at.candidates, last)
        counts = 1.0 if last is None else last.chi_square / limits.acceptance.max_redundant_ratio
        if best is None or (last is not None and best.chi_square > counts):
            best = _exchanged(here, at.candidates)
            keys = frozenset(best.keys)
            if keys in tried or (last is not None and (set(last.keys) == keys or best.chi_square > last.chi_square)):
                break
            tried.add(keys)
        again = about(at.regression, own, nuisances, best)
        if again is None or best.unsettled:
            break
        last, at = best, Pursued(again, [c for c in again.candidates if c.fitted is not None])
    return at if at.candidates else None


def _best_addition(regression: Regression, present: Sequence[Candidate], last: Fit | None) -> Fit | None:
    """The joint fit that leaves least of those with one more effect, None where none is possible. last: without it."""
    limits = regression.thresholds.search
    if len(present) >= limits.max_effects:
        return None
    values, best = None if last is None else last.values, None
    for candidates in _proposed(Search(regression), present):
        level = math.inf if best is None else best.chi_square
        trial = fit(regression, candidates, start=values, level=level, goal=level)
        best = trial if trial.chi_square < level else best
    return best


def _proposed(search: Search, present: Sequence[Candidate]) -> list[Set]:
    """The set with one more effect, for each of those with the highest scores, at its best grid point."""
    taken, best = {c.key for c in present}, dict[str, Set]()
    trials = search.scores([(*present, c) for c in search.regression.candidates if c.key not in taken])
    for scored in sorted(trials, key=lambda one: -one.score):
        if scored.score > IMPOSSIBLE:
            best.setdefault(scored.candidates[-1].key, scored.candidates)
    return list(best.values())[: search.thresholds.max_proposed]


def _exchanged(regression: Regression, present: Sequence[Candidate]) -> Fit:
    """The joint fit on the rotors, with the merged pairs and the rivals that the full model prefers."""
    decided = on_decided_rotors(regression, present, regression.vehicle)
    merged = merged_pairs(regression, decided, regression.vehicle)
    return fit(regression, decided_rivals(regression, merged, regression.vehicle)[0])


def about(
    regression: Regression, own: Sequence[Candidate], nuisances: Sequence[Candidate], fitted: Fit
) -> Regression | None:
    """The regression about a fit, None where that cannot be followed.

    own, nuisances: candidates about the vehicle's own model.
    """
    values = fitted.values
    held = about_values(own, fitted.candidates, values)
    return about_fit(regression, held, about_values(nuisances, nuisances, values))


def about_values(
    own: Sequence[Candidate], fitted: Sequence[Candidate], values: Mapping[tuple[str, str], float]
) -> tuple[Candidate, ...]:
    """Candidates, those that were fitted about their values by (key, parameter). own: about the vehicle's own model."""
    places = {c.columns for c in fitted}
    return tuple(
        c.about({n: v for (key, n), v in values.items() if key == c.key}) if c.columns in places else c for c in own
    )
