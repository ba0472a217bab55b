"""From flights and a vehicle to a verdict: which physical effect is missing, or that none in the catalogue fits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from diagnosis.candidates import Candidate
from diagnosis.dataset import Dataset
from diagnosis.evaluation import misfit, residuals
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
    leftover = look(regression, residuals(result.vehicle, catalogue, dataset.fitted, regression.noise))
    at_first = look(regression, regression.left_over([]))
    misfits = misfit(before, regression.noise), misfit(after, regression.noise)
    effects = found_effects(regression, selection, result)
    verdict = judge(effects, leftover, at_first, misfits)
    unseen = not_excited(regression, selection.chosen)
    apart = [effects[0].name, *effects[0].ambiguous_with] if effects else []
    floor = regression.noise.floor
    diagnosis = Diagnosis(
        verdict=verdict,
        effects=effects,
        channels=channel_errors(before, after, regression),
        not_excited=unseen,
        fails_where=worst_cells(regime_maps(dataset.held_out, before, floor, vehicle)),
        next_flight=next_flight(apart, unseen),
    )
    return Findings(
        diagnosis, result.vehicle, regression, selection, leftover, before, after, *misfits, dataset.notes
    )  # fmt: skip


def _accepted(regression: Regression, selection: Selection, dataset: Dataset) -> Fit:
    """The fit of as many of the chosen effects as lower the held-out error, each in its turn."""
    accepted: list[Candidate] = []
    catalogue, noise = regression.catalogue, regression.noise
    best = fit(regression, accepted)
    level = misfit(residuals(best.vehicle, catalogue, dataset.held_out, noise), noise)
    for candidate in selection.chosen.candidates:
        trial = fit(regression, [*accepted, candidate])
        if at_its_bounds(trial, candidate):
            continue
        found = misfit(residuals(trial.vehicle, catalogue, dataset.held_out, noise), noise)
        if found < IMPROVEMENT * level:
            best, level = trial, found
            accepted.append(candidate)
    return best


def at_its_bounds(found: Fit, candidate: Candidate) -> bool:
    """Whether a fit has driven a candidate's parameter to a physical bound: it then stands in for something else."""
    if candidate.effect.measurement is not None:  # a sensor may well be dead
        return False
    limits = {p.name: (p.lower, p.upper) for p in candidate.effect.parameters}
    return any(
        estimate.value in limits[name] for (key, name), estimate in found.estimates.items() if key == candidate.key
    )
