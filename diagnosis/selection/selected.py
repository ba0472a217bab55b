"""Selection of a search: a gust is a nuisance beside the effects, whose strength is estimated again with each set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from diagnosis.selection.candidates import Candidate
from diagnosis.selection.gust import Gust, gust_beside
from diagnosis.selection.regression import Regression
from diagnosis.selection.search import Scored, Search, Set, min_score


@dataclass(frozen=True, eq=False)
class Selection:
    """Selection of a search.

    chosen: the effects, the most important first.
    singles: each effect alone at its best grid point, best first.
    gust_before, gust: random air motion before and after the effects.
    gust_detected: whether a gust is among what is missing.
    gust_variance: of the gust that is a nuisance beside the effects, (m/s)^2, named or not.
    """

    chosen: Scored
    singles: tuple[Scored, ...]
    gust_before: Gust
    gust: Gust
    gust_detected: bool
    gust_variance: float = 0.0


def select(regression: Regression) -> Selection:
    """The effects that are missing, none where no score reaches its minimum."""
    thresholds, singles = regression.thresholds.search, Search(regression).singles()
    before = gust_beside(regression, [])
    top = Search(regression).first(singles)
    if top.score < min_score(top.candidates, thresholds):
        return Selection(Scored((), 0.0, 0.0), singles, before, before, _is_gust(before, regression, 0.0))
    required = max(_relevant(regression), thresholds.min_share * top.gain)
    starts: list[tuple[Set, float]] = [(top.candidates, 0.0)]
    if before.score >= thresholds.min_gain:
        starts.append(((), before.variance))
    results = [_searched(regression, candidates, variance, required) for candidates, variance in starts]
    chosen, variance, _ = max(results, key=lambda one: one[2])
    return _selection(regression, chosen, variance, required, singles, before)


def select_in_still_air(regression: Regression, first: Selection) -> Selection | None:
    """Selection without a gust, None where there is none or a drag beside it. first: the selection before.

    A gust acts through a drag, through the usual one of a vehicle that lacks it: it then moves as the vehicle does, and
    takes the place of the drag and of what resembles one.
    """
    drags = [c for c in regression.candidates if c.effect.resists_air]
    has_drag = any(c.present is not None for c in drags) or any(c.effect.resists_air for c in first.chosen.candidates)
    if has_drag or not drags or not first.gust_variance:
        return None
    required = max(_relevant(regression), regression.thresholds.search.min_share * first.singles[0].gain)
    search = Search(regression, required)
    chosen, _, _ = _searched(regression, search.first(first.singles).candidates, 0.0, required, in_still_air=True)
    return replace(first, chosen=search.ordered(chosen), gust=Gust(), gust_detected=False, gust_variance=0.0)


def select_from(
    regression: Regression, start: Sequence[Candidate], earlier: Selection, max_steps: int | None = None
) -> Selection:
    """The effects that are missing, by a search from a set on a regression about the fit of that set.

    max_steps: of the search, by default as many as its thresholds allow.
    """
    required, air = _relevant(regression), gust_variance(regression, tuple(start))
    starts = [(tuple(start), air), *([(one, 0.0) for one in _in_steady_wind(regression, start)] if air else [])]
    results = [_searched(regression, candidates, variance, required, max_steps) for candidates, variance in starts]
    chosen, variance, _ = max(results, key=lambda one: one[2])
    return _selection(regression, chosen, variance, required, earlier.singles, earlier.gust_before)


def _in_steady_wind(regression: Regression, start: Sequence[Candidate]) -> list[Set]:
    """The set with a steady wind, where it has none: in a gust none is worth adding, since that explains it as well.

    No step of a search leads there, since all are taken in one strength of gust.
    """
    if any(c.effect.wind is not None for c in start):
        return []
    return [(*start, c) for c in regression.candidates if c.effect.wind is not None]


def _selection(
    regression: Regression,
    chosen: Scored,
    variance: float,
    required: float,
    singles: tuple[Scored, ...],
    before: Gust,
) -> Selection:
    search = Search(regression.in_gust(variance), required)
    chosen = search.ordered(search.simplified(chosen))
    after = gust_beside(regression, chosen.columns)
    detected = _is_gust(after, regression, regression.thresholds.search.min_gust_share * chosen.gain)
    return Selection(chosen, singles, before, after, detected, variance)


def with_gust_beside(regression: Regression, selection: Selection, candidates: Sequence[Candidate]) -> Selection:
    """The selection with the gust beside certain effects, such as those that were accepted: what was selected and
    refused may have made room for it."""
    if {c.key for c in candidates} == {c.key for c in selection.chosen.candidates}:
        return selection
    return with_gust_by(regression, selection, candidates)


def with_gust_by(regression: Regression, selection: Selection, candidates: Sequence[Candidate]) -> Selection:
    """The selection with the gust that a regression shows beside certain effects."""
    columns = [i for c in candidates for i in c.columns]
    gust = gust_beside(regression, columns)
    required = regression.thresholds.search.min_gust_share * regression.gain(columns)
    return replace(selection, gust=gust, gust_detected=_is_gust(gust, regression, required))


def _relevant(regression: Regression) -> float:
    """Score by which an effect must raise that of the others to matter."""
    thresholds = regression.thresholds.search
    return max(thresholds.min_gain, thresholds.relevant * regression.total)


def _is_gust(gust: Gust, regression: Regression, min_score: float) -> bool:
    """Whether random air motion is a gust: clear in most resamples, and surely denser than an estimator's error.

    One as strong as the strongest that was tried stands in for a force that is none of the air.
    """
    limits = regression.thresholds.relevance
    surely = gust.intensity - limits.deviations * gust.std
    clear = surely > 0.0 and gust.share >= limits.min_agreement
    air = _error_as_gust(gust, regression) < surely
    air &= not _is_strongest(gust, regression)
    return clear and air and gust.score >= max(_relevant(regression), min_score)


def _searched(
    regression: Regression,
    start: Set,
    variance: float,
    required: float,
    max_steps: int | None = None,
    *,
    in_still_air: bool = False,
) -> tuple[Scored, float, float]:
    """The set to which the steps lead from a start, the variance of the gust beside it, and what both are worth.

    in_still_air: whether the variance stays as it is.
    """
    search = Search(regression.in_gust(variance), required)
    chosen = search.score(start)
    for _ in range(regression.thresholds.search.max_steps if max_steps is None else max_steps):
        better = search.better(chosen)
        if better is None:
            break
        chosen = better
        if in_still_air:
            continue
        variance = gust_variance(regression, chosen.candidates)
        if variance != search.regression.gust_variance:
            search = Search(regression.in_gust(variance), required)
            chosen = search.score(chosen.candidates)
    alone = regression.gust_profile([], [0.0, variance]).total()
    air = float(alone[1] - alone[0]) - (required if variance else 0.0)  # it must gain what an effect must
    return chosen, variance, search.worth(chosen) + air


def gust_variance(regression: Regression, chosen: Set) -> float:
    """Variance of the gust beside a set, (m/s)^2; 0 where it does not gain enough, or is the strongest that is tried,
    or no denser than an estimator's error, which the noise has already.

    The strongest stands in for a force that is none of the air: it leaves the forces nothing of slow motion, beside
    which a drag that is there has impossible values.
    """
    gust = gust_beside(regression, [i for c in chosen for i in c.columns], measured=False)
    none = gust.score < regression.thresholds.search.min_gain or _is_strongest(gust, regression)
    none |= gust.intensity <= _error_as_gust(gust, regression)
    return 0.0 if none else gust.variance


def _error_as_gust(gust: Gust, regression: Regression) -> float:
    """Intensity, m/s, of a gust with the same corner that an estimator's error of velocity may be."""
    return regression.thresholds.gust.over_error * regression.pose.as_gust(gust.corner)


def _is_strongest(gust: Gust, regression: Regression) -> bool:
    return gust.intensity >= (1 - 1e-6) * regression.thresholds.gust.intensity[1]
