"""Which of the chosen effects stand up to the full model and to flights that were not fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.data.dataset import Dataset
from diagnosis.data.segment import Segment
from diagnosis.estimation.equation_error import Fit, fit
from diagnosis.estimation.evaluation import misfit, residuals, typical_misfit
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.regression import Regression
from diagnosis.selection.rivals import near_rivals, rivals_of
from diagnosis.selection.search import Search, Selection
from dynamics.arrays import Floats

IMPROVEMENT = 0.999  # share of the held-out misfit that must remain at most after adding an effect
IDLE = 1.01  # times the misfit that may remain at most without an effect that others replace
UNSEEN = 25.0  # squared change over noise on held-out flights, less of which tells nothing
LEADING = 2  # effects whose rivals are tried in the full model


def accepted_fit(regression: Regression, selection: Selection, dataset: Dataset) -> Fit:
    """The fit of as many of the chosen effects as held-out flights bear out, each in its turn."""
    accepted: list[Candidate] = []
    best = fit(regression, accepted)
    rows = _held_out(best, regression, dataset)
    for candidate in _best_form(regression, selection.chosen.candidates, dataset):
        trial = fit(regression, [*accepted, candidate])
        if at_its_bounds(trial, candidate):
            continue
        changed = _held_out(trial, regression, dataset)
        if borne_out(rows, changed, regression):
            best, rows = trial, changed
            accepted.append(candidate)
    return _with_known(_without_idle(best, regression, dataset), regression, dataset)


def _with_known(best: Fit, regression: Regression, dataset: Dataset) -> Fit:
    """The fit with the vehicle file's own effects fitted anew beside what was found, where that helps held-out flights.

    They were fitted without what is found now, and may have stood in for it.
    """
    held = {(use.name, use.rotor) for use in regression.vehicle.effects}
    mine = {c.key for c in best.candidates}
    known = [c for c in regression.candidates if (c.effect.name, c.rotor) in held and not c.whole and c.key not in mine]
    if not known or not best.candidates:
        return best
    together = fit(regression, [*best.candidates, *known])
    levels = [_level(found, regression, dataset.held_out) for found in (best, together)]
    if not levels[1] < IMPROVEMENT * levels[0]:
        return best
    estimates = {key: value for key, value in together.estimates.items() if key[0] in mine}
    return Fit(together.vehicle, estimates, best.candidates)


def _without_idle(best: Fit, regression: Regression, dataset: Dataset) -> Fit:
    """The fit without effects that the others, fitted anew, replace on the fitted and on the held-out flights."""

    def levels(found: Fit) -> list[float]:
        return [_level(found, regression, part) for part in (dataset.fitted, dataset.held_out)]

    while len(best.candidates) > 1:
        limits = [IDLE * level for level in levels(best)]
        fewer = [fit(regression, [c for c in best.candidates if c is not one]) for one in best.candidates]
        reached = [(levels(trial), trial) for trial in fewer]
        idle = [
            (sum(now), trial) for now, trial in reached if all(n <= limit for n, limit in zip(now, limits, strict=True))
        ]
        if not idle:
            return best
        best = min(idle, key=lambda found: found[0])[1]
    return best


def _best_form(regression: Regression, chosen: Sequence[Candidate], dataset: Dataset) -> tuple[Candidate, ...]:
    """The chosen effects, the first two in favour of near rivals where the full model fits clearly better with them.

    To the linear regression a wrong mass and a wrong thrust constant are the same; beside a strong drag they are not.
    """
    search, best, level = Search(regression), list(chosen), 0.0
    for place in range(min(len(chosen), LEADING)):
        leading = best[:LEADING]
        others = [c for i, c in enumerate(leading) if i != place]
        near = near_rivals(search, others, rivals_of(search, others, leading[place]))
        for rival in near[:1]:
            level = level or _level(fit(regression, leading), regression, dataset.everything)
            trial = [*leading[:place], rival.candidates[-1], *leading[place + 1 :]]
            found = _level(fit(regression, trial), regression, dataset.everything)
            if IDLE * found < level:
                best, level = [*trial, *best[LEADING:]], found
    return tuple(best)


def _level(found: Fit, regression: Regression, segments: Sequence[Segment]) -> float:
    return misfit(residuals(found.vehicle, regression.catalogue, segments, regression.noise), regression.noise)


def _held_out(found: Fit, regression: Regression, dataset: Dataset) -> list[Floats]:
    return residuals(found.vehicle, regression.catalogue, dataset.held_out, regression.noise)


def borne_out(before: Sequence[Floats], after: Sequence[Floats], regression: Regression) -> bool:
    """Whether an addition lowers the held-out error, in all or, where seconds of chaos outweigh it, typically.

    Flights on which it changes next to nothing cannot tell; there the fitted flights that were left out have told.
    """
    noise = regression.noise
    changes = sum(float(np.sum(noise.whiten(a - b) ** 2)) for a, b in zip(after, before, strict=True))
    if changes < UNSEEN:
        return True
    typical = [typical_misfit(rows, noise, regression.rate) for rows in (before, after)]
    return misfit(after, noise) < IMPROVEMENT * misfit(before, noise) or typical[1] < IMPROVEMENT * typical[0]


def at_its_bounds(found: Fit, candidate: Candidate) -> bool:
    """Whether a fit has driven a candidate's parameter to a physical bound: it then stands in for something else."""
    if candidate.effect.measurement is not None:  # a sensor may well be dead
        return False
    # where the effect vanishes it stands in for nothing: the vehicle file may claim one that is not there
    limits = {p.name: {p.lower, p.upper} - {p.neutral} for p in candidate.effect.parameters}
    return any(
        estimate.value in limits[name] for (key, name), estimate in found.estimates.items() if key == candidate.key
    )
