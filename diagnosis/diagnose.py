"""From flights and a vehicle to a verdict: which physical effect is missing, or that none in the catalogue fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.candidates import Candidate
from diagnosis.dataset import Dataset
from diagnosis.evaluation import misfit, residuals, typical_misfit
from diagnosis.filters import Floats
from diagnosis.fit import Fit, fit
from diagnosis.fitness import require_answerable
from diagnosis.next_flight import next_flight
from diagnosis.regimes import regime_maps, worst_cells
from diagnosis.regression import Regression, make_regression
from diagnosis.report import Diagnosis
from diagnosis.selection import Selection, select
from diagnosis.unexplained import Leftover, look
from diagnosis.verdict import channel_errors, found_effects, judge, not_excited
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle

IMPROVEMENT = 0.999  # share of the held-out misfit that must remain at most after adding an effect
IDLE = 1.01  # times the misfit that may remain at most without an effect that others replace
UNSEEN = 25.0  # squared change over noise on held-out flights, less of which tells nothing


@dataclass(frozen=True, eq=False)
class Findings:
    """The diagnosis and what it was made from. vehicle: with the effects that were found at their fitted values.

    before, after: (m, 12) residuals on the held-out stretches. notes: what the user should know of the data.
    """

    diagnosis: Diagnosis
    vehicle: Vehicle
    regression: Regression
    selection: Selection
    leftover: Leftover
    before: list[Floats]
    after: list[Floats]
    misfit_before: float
    misfit_after: float
    notes: tuple[str, ...]


def diagnose(dataset: Dataset, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> Findings:
    """Name the physical effect that is missing from a vehicle's model.

    Raises DataError when the flights cannot answer.
    """
    require_answerable(dataset.everything, vehicle)
    regression = make_regression(vehicle, catalogue, dataset.fitted, dataset.flight_of)
    selection = select(regression)
    result = _accepted(regression, selection, dataset)
    before = residuals(vehicle, catalogue, dataset.held_out, regression.noise)
    after = residuals(result.vehicle, catalogue, dataset.held_out, regression.noise)
    left = residuals(result.vehicle, catalogue, dataset.fitted, regression.noise)
    leftover = look(regression, left, places=selection.blows)
    at_first = look(regression, regression.left_over([])) if result.candidates else leftover
    misfits = misfit(before, regression.noise), misfit(after, regression.noise)
    typical = [typical_misfit(rows, regression.noise, regression.rate) for rows in (before, after)]
    effects = found_effects(regression, selection, result)
    gust_share = selection.gust.gain / max(regression.total, 1)
    verdict = judge(effects, leftover, at_first, (typical[0], typical[1]), gust_share)
    unseen = not_excited(regression, selection.chosen)
    apart = [effects[0].name, *effects[0].ambiguous_with] if effects else []
    floor = regression.noise.floor
    diagnosis = Diagnosis(
        verdict=verdict,
        effects=effects,
        channels=channel_errors(before, after, regression, dataset.held_out),
        not_excited=unseen,
        fails_where=worst_cells(regime_maps(dataset.held_out, before, floor, vehicle)),
        next_flight=next_flight(apart, unseen),
    )
    return Findings(
        diagnosis, result.vehicle, regression, selection, leftover, before, after, *misfits, dataset.notes
    )  # fmt: skip


def _accepted(regression: Regression, selection: Selection, dataset: Dataset) -> Fit:
    """The fit of as many of the chosen effects as held-out flights bear out, each in its turn."""
    accepted: list[Candidate] = []
    best = fit(regression, accepted)
    rows = _held_out(best, regression, dataset)
    for candidate in selection.chosen.candidates:
        trial = fit(regression, [*accepted, candidate])
        if at_its_bounds(trial, candidate):
            continue
        changed = _held_out(trial, regression, dataset)
        if borne_out(rows, changed, regression):
            best, rows = trial, changed
            accepted.append(candidate)
    return _without_idle(best, regression, dataset)


def _without_idle(best: Fit, regression: Regression, dataset: Dataset) -> Fit:
    """The fit without effects that the others, fitted anew, replace on the fitted and on the held-out flights."""
    noise = regression.noise

    def levels(found: Fit) -> list[float]:
        parts = (dataset.fitted, dataset.held_out)
        return [misfit(residuals(found.vehicle, regression.catalogue, part, noise), noise) for part in parts]

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
    limits = {p.name: (p.lower, p.upper) for p in candidate.effect.parameters}
    return any(
        estimate.value in limits[name] for (key, name), estimate in found.estimates.items() if key == candidate.key
    )
