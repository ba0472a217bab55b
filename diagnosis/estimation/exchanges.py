"""Accepted effects exchanged for others, one or two at once, where the full model about them then leaves less.

A mass beside a torque constant may be what is nearest to a thrust constant beside a damping, and a drag at the rotors
beside an inflow to a drag of the body beside a damping: each exchange of one of the two leaves more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import Accepted, judged_fit
from diagnosis.estimation.equation_error import fit
from diagnosis.estimation.fitted import Fit
from diagnosis.estimation.pursuit import about
from diagnosis.estimation.slow_motion import SlowMotion
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.selection.rivals import declared_alike
from diagnosis.selection.search import Search, Set
from dynamics.vehicle import Vehicle


def with_exchanges(regression: Regression, accepted: Accepted, dataset: Dataset, vehicle: Vehicle) -> Accepted:
    """The same with effects exchanged until slow motion leaves less of no other set, once it has been judged.

    vehicle: that they are added to.
    """
    slow, tried = SlowMotion(regression), {frozenset(accepted.fit.keys)}
    while accepted.fit.candidates and (better := _better(regression, slow, accepted, dataset, vehicle, tried)):
        accepted = better
    return accepted


def _better(
    regression: Regression,
    slow: SlowMotion,
    accepted: Accepted,
    dataset: Dataset,
    vehicle: Vehicle,
    tried: set[frozenset[str]],
) -> Accepted | None:
    """A judged set of which slow motion leaves clearly less, None where none is found. tried: sets, to be added to."""
    search, limits = Search(regression), regression.thresholds

    def left(fitted: Fit) -> float:
        return slow.left(fitted.vehicle) + sum(map(search.penalty, fitted.candidates))

    own = slow.left(accepted.fit.vehicle)
    if own <= slow.count:  # as much as chance
        return None
    most = left(accepted.fit) - max(limits.rivals.score_margin, limits.slow_motion.min_fall * own)
    for candidates in _proposed(regression, accepted.fit, vehicle, own):
        if (keys := frozenset(c.key for c in candidates)) in tried:
            continue
        tried.add(keys)
        trial = fit(regression, candidates, vehicle=vehicle, level=accepted.fit.chi_square)
        if trial.unsettled or left(trial) > most:
            continue
        judged = judged_fit(regression, candidates, dataset, vehicle, refused=accepted.refused)
        if left(judged.fit) <= most:
            return judged
    return None


def _proposed(regression: Regression, fitted: Fit, vehicle: Vehicle, left: float) -> Iterator[Set]:
    """Sets that may leave less: by columns about the fit, then about fits with an effect in place of one that is
    declared to look like it.

    A thrust constant with an inertia and a torque constant is a mass: from there other exchanges are near.
    left: of the fit, by slow motion.
    """
    search = _search_about(regression, fitted)
    if search is None:
        return
    yield from _exchanged(regression, search, fitted)
    own, names = search.score(_of(search.regression, fitted.candidates)), {c.effect.name for c in fitted.candidates}
    for one in fitted.candidates:
        for kin in regression.candidates:
            if kin.effect.name in names or not declared_alike(one, kin):
                continue
            alike = [kin if c is one else c for c in fitted.candidates]
            if search.score(_of(search.regression, alike)).score < own.score - left:
                continue
            trial = fit(regression, alike, vehicle=vehicle, level=fitted.chi_square)
            about_kin = None if trial.unsettled else _search_about(regression, trial)
            if about_kin is not None:
                yield from _exchanged(regression, about_kin, trial)


def _search_about(regression: Regression, fitted: Fit) -> Search | None:
    """A search by slow motion about a fit, None where that cannot be followed."""
    own = tuple(replace(candidate, fitted=None) for candidate in regression.candidates)
    here = about(regression, own, regression.nuisances, fitted)
    return None if here is None else Search(SlowMotion(here).regression())


def _exchanged(regression: Regression, search: Search, fitted: Fit) -> list[Set]:
    """Sets with one or two effects exchanged that leave less by columns about the fit, the best first.

    Of those that add the same, or more than that, the best one.
    """
    best, added = list[Set](), list[set[str]]()
    for scored in search.exchanges(_of(search.regression, fitted.candidates)):
        new = {c.key for c in scored.candidates} - set(fitted.keys)
        if new and not any(new >= before for before in added):
            added.append(new)
            best.append(_of(regression, scored.candidates))
    return best[: regression.thresholds.search.max_proposed]


def _of(regression: Regression, candidates: Sequence[Candidate]) -> Set:
    """The same candidates of another regression."""
    by_columns = {c.columns: c for c in regression.candidates}
    return tuple(by_columns[c.columns] for c in candidates)
