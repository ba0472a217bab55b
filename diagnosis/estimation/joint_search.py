"""Search and fit in turns: what was selected is fitted jointly, all columns are made again about that fit, and the
search goes on, until it adds nothing.

Effects change each other's columns, so that the first linearisation, about the vehicle's own model, is wrong where
much is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from diagnosis.estimation.alternatives import decided_rivals
from diagnosis.estimation.equation_error import fit
from diagnosis.estimation.evaluation import errs_as_assumed
from diagnosis.estimation.fitted import Fit
from diagnosis.estimation.pursuit import about, pursue
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.selection.search import IMPOSSIBLE, Search
from diagnosis.selection.selected import (
    Selection,
    select,
    select_from,
    select_in_still_air,
    with_gust_beside,
    with_gust_by,
)


def search_jointly(regression: Regression) -> tuple[Regression, Selection]:
    """Missing effects, and the regression about them: linear about the joint fit, in the gust that was detected.

    Where the full model leaves much, and a gust stood in for a drag, the search begins again in still air; what that
    selects counts if it explains the flights. Where something is left then, the full model pursues it effect by
    effect; what that selects counts if it leaves less, both with rivals that the full model prefers.
    """
    thresholds = regression.thresholds.search
    first = select(regression)
    best = _explored(regression, first)
    if best.chi_square > thresholds.unexplained and (still := select_in_still_air(regression, first)) is not None:
        other = _explored(regression, still)
        best = other if other.chi_square <= thresholds.still_explained else best
    if best.chi_square > regression.explained:
        level = _decided_chi_square(best)
        if level > regression.explained:
            again = _pursued(regression, best, level)
            required = regression.thresholds.acceptance.max_redundant_ratio * _decided_chi_square(again)
            best = again if level > required else best
    return best.regression.in_gust(best.selection.gust_variance), best.selection


def with_gust_about(
    regression: Regression, first: Regression, selection: Selection, fitted: Fit
) -> tuple[Regression, Selection]:
    """The selection with the gust beside a fit, and the regression by which it is judged.

    A gust that is detected is judged again by rows and columns about that fit: about another one, as that of a vehicle
    in still air, they leave what is not linear in a steady wind, which looks like a gust. first: the regression before
    the search.
    """
    selection = with_gust_beside(regression, selection, fitted.candidates)
    if not selection.gust_detected or not fitted.candidates:
        return regression, selection
    again = about(regression, first.candidates, first.nuisances, fitted)
    if again is None:
        return regression, selection
    return again, with_gust_by(again, selection, fitted.candidates)


@dataclass(frozen=True, eq=False)
class _Explored:
    """Where the rounds have led from a selection.

    regression: about the last fit but one. selection: by it. chi_square: reduced, of its joint fit; 0 of none.
    """

    regression: Regression
    selection: Selection
    chi_square: float


def _decided_chi_square(explored: _Explored) -> float:
    """Reduced chi-square of what is selected with those rivals of its effects that the full model prefers."""
    regression = explored.regression.in_gust(explored.selection.gust_variance)
    decided, _ = decided_rivals(regression, explored.selection.chosen.candidates, regression.vehicle)
    return fit(regression, decided).chi_square


def _pursued(regression: Regression, best: _Explored, level: float) -> _Explored:
    """Where the pursuit leads, in the gust that is beside the best set so far unless that set leaves much.

    level: reduced chi-square of that set.
    """
    explained = level <= regression.thresholds.search.still_explained
    pursued = pursue(regression, best.selection.gust_variance if explained and best.selection.gust_detected else 0.0)
    if pursued is None:
        return best
    selection = select_from(pursued.regression, pursued.candidates, best.selection, max_steps=0)
    return _Explored(pursued.regression, selection, fit(pursued.regression, selection.chosen.candidates).chi_square)


def _explored(regression: Regression, selection: Selection) -> _Explored:
    thresholds, own, nuisances = regression.thresholds.search, regression.candidates, regression.nuisances
    if not selection.chosen.candidates:
        return _Explored(regression, selection, 0.0)
    fitted = fit(regression, selection.chosen.candidates)
    for number in range(thresholds.max_rounds - 1):
        is_explained = fitted.chi_square < thresholds.explained
        if number == 0 and not is_explained:
            pairs = (fit(regression, pair) for pair in _drags_in_wind(regression, selection))
            fitted = next((f for f in pairs if f.chi_square < thresholds.max_pair_share * fitted.chi_square), fitted)
        # about another fit, a gust beside one that explains the flights is what its columns leave
        is_done = is_explained and (number == 0 or not selection.gust_detected)
        is_done &= errs_as_assumed(regression, fitted.vehicle)
        if fitted.unsettled or is_done:
            break
        again = about(regression, own, nuisances, fitted)
        if again is None:
            break
        held = again.candidates
        regression, last = again, fitted
        selection, fitted = _trusted(regression, [c for c in held if c.fitted is not None], selection, last)
        if {c.key for c in selection.chosen.candidates} <= set(last.keys):
            break
    return _Explored(regression, selection, fitted.chi_square)


def _trusted(
    regression: Regression, start: Sequence[Candidate], earlier: Selection, last: Fit
) -> tuple[Selection, Fit]:
    """Selection of a search from a set, and its joint fit, after fewer steps where that is far worse than the last one.

    Columns about a fit that leaves much are right near it alone: a set that many steps away gains the most by them may
    explain far less in the full model, or nothing that is possible. The steps are then halved, down to none.
    """
    max_chi_square = regression.thresholds.search.max_growth * last.chi_square
    selection = select_from(regression, start, earlier)
    fitted = fit(regression, selection.chosen.candidates)
    steps = len(selection.chosen.candidates)
    while steps and not (selection.chosen.score > IMPOSSIBLE and fitted.chi_square <= max_chi_square):
        steps //= 2
        selection = select_from(regression, start, earlier, max_steps=steps)
        fitted = fit(regression, selection.chosen.candidates)
    return selection, fitted


def _drags_in_wind(regression: Regression, selection: Selection) -> list[tuple[Candidate, ...]]:
    """The drag that explains most together with a steady wind, where the air moves and the vehicle lacks a drag.

    Wind acts through drag, at the rotors or wherever the drag does: about a vehicle without one its columns miss the
    moments, and the search fills up with what resembles them, or takes the wind for a gust.
    """
    thresholds, drags = regression.thresholds.search, [c for c in regression.candidates if c.effect.resists_air]
    if selection.gust_before.score < thresholds.min_gain or any(c.present is not None for c in drags):
        return []
    winds = [c for c in regression.candidates if c.effect.wind is not None]
    pairs = [(drag, wind) for drag in drags for wind in winds]
    best = max(Search(regression).scores(pairs), key=lambda one: one.score, default=None)
    return [] if best is None or best.score < thresholds.min_gain else [best.candidates]
