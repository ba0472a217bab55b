"""Acceptance of the selected effects: forward, then backward, in the full model and on held-out flights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.data.dataset import Dataset
from diagnosis.data.segment import Segment
from diagnosis.estimation.equation_error import Fit, fit
from diagnosis.estimation.evaluation import reduced_chi_square, residuals_in, typical_chi_square
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.selection.rivals import near_rivals, rivals_of
from diagnosis.selection.search import Search, Selection
from dynamics.arrays import Floats


def accepted_fit(regression: Regression, selection: Selection, dataset: Dataset) -> Fit:
    """The fit of as many of the selected effects as lower the error on held-out flights, added one by one."""
    accepted: list[Candidate] = []
    best = fit(regression, accepted)
    rows = residuals_in(regression, best.vehicle, dataset.held_out)
    for candidate in _decided_rivals(regression, selection.chosen.candidates, dataset):
        trial = fit(regression, [*accepted, candidate])
        if at_its_bounds(trial, candidate):
            continue
        trial_rows = residuals_in(regression, trial.vehicle, dataset.held_out)
        if confirmed(rows, trial_rows, regression):
            best, rows = trial, trial_rows
            accepted.append(candidate)
    return _with_refitted_effects(_without_redundant(best, regression, dataset), regression, dataset)


def _with_refitted_effects(best: Fit, regression: Regression, dataset: Dataset) -> Fit:
    """The fit with the vehicle file's own effects fitted again beside the new ones, where that helps held-out flights.

    They were fitted without the new ones, and may have absorbed a part of them.
    """
    names = {(use.name, use.rotor) for use in regression.vehicle.effects}
    new = {c.key for c in best.candidates}
    own = [
        c for c in regression.candidates if (c.effect.name, c.rotor) in names and not c.fixed_shape and c.key not in new
    ]
    if not own or not best.candidates:
        return best
    together = fit(regression, [*best.candidates, *own])
    before, after = (_chi_square(trial, regression, dataset.held_out) for trial in (best, together))
    if not after < regression.thresholds.acceptance.max_ratio * before:
        return best
    estimates = {key: value for key, value in together.estimates.items() if key[0] in new}
    return Fit(together.vehicle, estimates, best.candidates)


def _without_redundant(best: Fit, regression: Regression, dataset: Dataset) -> Fit:
    """The fit without effects that the others, fitted again, replace on the fitted and on the held-out flights."""
    max_ratio = regression.thresholds.acceptance.max_redundant_ratio

    def levels(trial: Fit) -> list[float]:
        return [_chi_square(trial, regression, part) for part in (dataset.fitted, dataset.held_out)]

    while len(best.candidates) > 1:
        limits = [max_ratio * level for level in levels(best)]
        fewer = [fit(regression, [c for c in best.candidates if c is not one]) for one in best.candidates]
        reached = [(levels(trial), trial) for trial in fewer]
        as_good = [
            (sum(now), trial) for now, trial in reached if all(n <= limit for n, limit in zip(now, limits, strict=True))
        ]
        if not as_good:
            return best
        best = min(as_good, key=lambda pair: pair[0])[1]
    return best


def _decided_rivals(regression: Regression, chosen: Sequence[Candidate], dataset: Dataset) -> tuple[Candidate, ...]:
    """The selected effects, the leading ones in favour of near rivals with which the full model fits clearly better.

    To the linear regression a wrong mass and a wrong thrust constant are the same; beside a strong drag they are not.
    """
    thresholds = regression.thresholds.acceptance
    search, best, level = Search(regression), list(chosen), 0.0
    for place in range(min(len(chosen), thresholds.leading)):
        leading = best[: thresholds.leading]
        others = [c for i, c in enumerate(leading) if i != place]
        near = near_rivals(search, others, rivals_of(search, others, leading[place]))
        for rival in near[:1]:
            level = level or _chi_square(fit(regression, leading), regression, dataset.everything)
            trial = [*leading[:place], rival.candidates[-1], *leading[place + 1 :]]
            trial_level = _chi_square(fit(regression, trial), regression, dataset.everything)
            if thresholds.max_redundant_ratio * trial_level < level:
                best, level = [*trial, *best[thresholds.leading :]], trial_level
    return tuple(best)


def _chi_square(trial: Fit, regression: Regression, segments: Sequence[Segment]) -> float:
    return reduced_chi_square(residuals_in(regression, trial.vehicle, segments), regression.noise)


def confirmed(before: Sequence[Floats], after: Sequence[Floats], regression: Regression) -> bool:
    """Whether an addition lowers the held-out error, in the mean or in a typical window.

    A few chaotic seconds may dominate the mean. Where the addition changes next to nothing it is confirmed, since
    cross-validation on the fitted flights has selected it.
    before, after: (m, 12) residuals of the held-out segments.
    """
    noise, thresholds = regression.noise, regression.thresholds.acceptance
    change = sum(float(np.sum(noise.whiten(a - b) ** 2)) for a, b in zip(after, before, strict=True))
    if change < thresholds.min_held_out_change:
        return True
    means = [reduced_chi_square(rows, noise) for rows in (before, after)]
    typical = [typical_chi_square(rows, regression) for rows in (before, after)]
    return any(was_now[1] < thresholds.max_ratio * was_now[0] for was_now in (means, typical))


def at_its_bounds(trial: Fit, candidate: Candidate) -> bool:
    """Whether a fit has driven a candidate's parameter to a physical bound, where it likely absorbs another effect."""
    if candidate.effect.measurement is not None:  # a sensor may well be dead
        return False
    # at its neutral value the effect vanishes and absorbs nothing: the vehicle file may name one that does not exist
    limits = {p.name: {p.lower, p.upper} - {p.neutral} for p in candidate.effect.parameters}
    return any(
        estimate.value in limits[name] for (key, name), estimate in trial.estimates.items() if key == candidate.key
    )
