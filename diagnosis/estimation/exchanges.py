"""Accepted effects exchanged for others, one or two at once, where slow motion leaves less of the full model then.

A mass beside a torque constant may be what is nearest to a thrust constant beside a damping, and a drag at the rotors
beside an inflow to a drag of the body beside a damping: each exchange of one of the two leaves more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import Accepted, judged_fit
from diagnosis.estimation.equation_error import fit
from diagnosis.estimation.fitted import Fit
from diagnosis.estimation.pursuit import about
from diagnosis.estimation.slow_motion import SlowMotion
from diagnosis.selection.candidates import Candidate, scales_rotors
from diagnosis.selection.regression import Regression
from diagnosis.selection.rivals import declared_alike, rivals_of
from diagnosis.selection.search import Scored, Search, Set
from dynamics.vehicle import Vehicle


def with_exchanges(
    regression: Regression, accepted: Accepted, dataset: Dataset, vehicle: Vehicle, *, in_gust: bool = False
) -> Accepted:
    """Accepted set after exchanges of effects, where slow motion leaves clearly less of another set that is judged.

    What is sought is the set of which slow motion leaves least, with more effects than held-out flights bear out: what
    stands in for a small one is no exchange for its sake. Where slow motion refutes that set, too, something else is
    missing, and none is better than another. Of a set that it does not refute, two effects may be one of another name,
    and what scales the rotors' forces may be what is declared to look alike.
    vehicle: that they are added to. in_gust: whether the air moves, which is as slow and refutes any set.
    """
    if not accepted.fit.candidates:
        return accepted
    walk = _Walk(regression, vehicle)
    right = in_gust or walk.is_within_chance(accepted.fit)
    best = walk.merged(accepted.fit) if right else walk.from_fit(accepted.fit)
    best = walk.decided(best) if right and not in_gust else best
    if set(best.keys) == set(accepted.fit.keys) or not (right or walk.is_within_chance(best)):
        return accepted
    judged = judged_fit(regression, best.candidates, dataset, vehicle, refused=accepted.refused)
    is_better = bool(judged.fit.candidates) and walk.is_better(judged.fit, accepted.fit)
    return judged if is_better else accepted


class _Walk:
    """Steps from set to set, each to the one of which slow motion leaves least, penalties of coefficients included."""

    def __init__(self, regression: Regression, vehicle: Vehicle) -> None:
        self._regression, self._vehicle = regression, vehicle
        self._slow, self._search = SlowMotion(regression), Search(regression)
        self._results: dict[Fit, float] = {}

    def from_fit(self, fitted: Fit) -> Fit:
        """The fit from where no further step leaves clearly less."""
        return self._walked(fitted, lambda here: self._fits(self._proposed(Search.near, here), here))

    def merged(self, fitted: Fit) -> Fit:
        """The fit with one effect in place of two, again and again, where that leaves as much of all motion, too."""

        def trials(here: Fit) -> list[Fit]:
            sets = self._proposed(Search.merged, here) if len(here.candidates) > 1 else []
            return [trial for trial in self._fits(sets, here) if self._is_as_good(trial, here)]

        return self._walked(fitted, trials)

    def decided(self, fitted: Fit) -> Fit:
        """The fit with what is declared to look alike in place of what scales the rotors' forces, or the reverse.

        A thrust constant acts on the moments, a mass does not, and turbulence makes the moments look too small: all
        motion prefers the constant wherever the thrust is less than the weight says, and the mass where it is more.
        """
        return self._walked(fitted, lambda here: self._fits(self._alike(here.candidates), here))

    def _walked(self, fitted: Fit, trials: Callable[[Fit], Sequence[Fit]]) -> Fit:
        """The fit to which trials about each lead, until none leaves clearly less."""
        while True:
            settled = (trial for trial in trials(fitted) if not trial.unsettled)
            best = min(settled, key=self._cost, default=fitted)
            if not self.is_better(best, fitted):
                return fitted
            fitted = best

    def _alike(self, present: Sequence[Candidate]) -> list[Set]:
        """Sets with one effect in place of another that is declared alike, one of which scales the rotors."""
        sets = list[Set]()
        for candidate in present:
            others = [c for c in present if c is not candidate]
            for scored in rivals_of(self._search, others, candidate)[1:]:
                rival = scored.candidates[-1]
                scales = scales_rotors(candidate) or scales_rotors(rival)
                if scales and declared_alike(candidate, rival) and len(rival.columns) == len(candidate.columns):
                    sets.append(scored.candidates)
        return sets

    def _is_as_good(self, trial: Fit, fitted: Fit) -> bool:
        """Whether a fit leaves no more of all motion than the coefficients cost that it saves."""
        saved = self._penalty(fitted) - self._penalty(trial)
        return (trial.chi_square - fitted.chi_square) * self._regression.total < saved

    def is_within_chance(self, fitted: Fit) -> bool:
        """Whether slow motion leaves little more than it would of noise."""
        bound = self._regression.thresholds.slow_motion.enough * self._slow.count
        return self._left(fitted) <= bound

    def is_better(self, one: Fit, other: Fit) -> bool:
        """Whether slow motion leaves clearly less of one set than of another."""
        limits = self._regression.thresholds
        required = limits.slow_motion.min_fall * self._left(other)
        return self._cost(one) <= self._cost(other) - max(limits.rivals.score_margin, required)

    def _cost(self, fitted: Fit) -> float:
        return self._left(fitted) + self._penalty(fitted)

    def _penalty(self, fitted: Fit) -> float:
        return sum(map(self._search.penalty, fitted.candidates))

    def _left(self, fitted: Fit) -> float:
        if fitted not in self._results:
            self._results[fitted] = self._slow.left(fitted, self._vehicle)
        return self._results[fitted]

    def _fits(self, sets: Sequence[Set], fitted: Fit) -> list[Fit]:
        """Of sets that are compared with a fit."""
        return [fit(self._regression, s, vehicle=self._vehicle, level=fitted.chi_square) for s in sets]

    def _proposed(self, propose: Callable[[Search, Set], Sequence[Scored]], fitted: Fit) -> list[Set]:
        """Sets that leave less by columns about a fit, the best first.

        Of those that add the same, or more than that, the best one.
        """
        search = _search_about(self._regression, fitted)
        if search is None:
            return []
        best, added = list[Set](), list[set[str]]()
        for scored in propose(search, _of(search.regression, fitted.candidates)):
            new = {c.key for c in scored.candidates} - set(fitted.keys)
            if new and not any(new >= before for before in added):
                added.append(new)
                best.append(_of(self._regression, scored.candidates))
        return best[: self._search.thresholds.max_proposed]


def _search_about(regression: Regression, fitted: Fit) -> Search | None:
    """A search by slow motion about a fit, None where that cannot be followed."""
    own = tuple(replace(candidate, fitted=None) for candidate in regression.candidates)
    here = about(regression, own, regression.nuisances, fitted)
    return None if here is None else Search(SlowMotion(here).regression())


def _of(regression: Regression, candidates: Sequence[Candidate]) -> Set:
    """Candidates of another regression, of the keys of these."""
    by_columns = {c.columns: c for c in regression.candidates}
    return tuple(by_columns[c.columns] for c in candidates)
