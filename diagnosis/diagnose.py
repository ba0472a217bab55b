"""From flights and a vehicle to a verdict: which physical effect is missing, or that none in the catalogue fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.candidates import Candidate
from diagnosis.dataset import Dataset
from diagnosis.evaluation import Biases, misfit, residuals
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
    result, biases = _accepted(regression, selection, dataset)
    before = residuals(vehicle, catalogue, dataset.held_out, biases)
    after = residuals(result.vehicle, catalogue, dataset.held_out, biases)
    fitted_rows = residuals(result.vehicle, catalogue, dataset.fitted, biases)
    leftover, at_first = look(regression, fitted_rows), look(regression, regression.rows)
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


def _accepted(regression: Regression, selection: Selection, dataset: Dataset) -> tuple[Fit, Biases]:
    """The fit of as many of the chosen effects as lower the held-out error, each in its turn."""
    accepted: list[Candidate] = []
    vehicle, catalogue = regression.vehicle, regression.catalogue
    best = fit_of(regression, accepted)
    level = misfit(residuals(vehicle, catalogue, dataset.held_out, biases_of(best, regression)), regression.noise)
    for candidate in selection.chosen.candidates:
        trial = fit_of(regression, [*accepted, candidate])
        rows = residuals(trial.vehicle, catalogue, dataset.held_out, biases_of(trial, regression))
        found = misfit(rows, regression.noise)
        if found < IMPROVEMENT * level:
            best, level = trial, found
            accepted.append(candidate)
    return best, biases_of(best, regression)


def fit_of(regression: Regression, candidates: Sequence[Candidate]) -> Fit:
    """Joint fit of candidates; of none, the sensors' biases alone."""
    if candidates:
        return fit(regression, candidates)
    theta, _ = regression.solve([])
    return Fit(regression.vehicle, {}, dict(zip(regression.nuisance, theta.tolist(), strict=True)), ())


def biases_of(result: Fit, regression: Regression) -> Biases:
    """The nuisances of a fit as what the sensors are off by."""
    gyro, accelerometer, clock = np.zeros(3), np.zeros(3), 0.0
    for candidate in regression.candidates:
        values = [result.nuisance.get(i, 0.0) for i in candidate.columns]
        if candidate.effect.name == "gyro_bias":
            gyro = np.array(values)
        elif candidate.effect.name == "imu_bias":
            accelerometer = np.array(values)
        elif candidate.effect.name == "time_delay" and candidate.columns[0] in result.nuisance:
            clock = values[0] * candidate.at["delay"]
    g, a = gyro.tolist(), accelerometer.tolist()
    return Biases((g[0], g[1], g[2]), (a[0], a[1], a[2]), clock)
