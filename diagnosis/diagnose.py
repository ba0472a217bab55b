"""From flights and a vehicle to a verdict: which physical effect is missing, or that none in the catalogue fits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import accepted_fit
from diagnosis.estimation.evaluation import misfit, residuals, typical_misfit
from diagnosis.next_flight import next_flight
from diagnosis.regimes import regime_maps, worst_cells
from diagnosis.report import Diagnosis
from diagnosis.selection.regression import Regression, make_regression
from diagnosis.selection.residual_tests import Leftover, look
from diagnosis.selection.search import Selection, select
from diagnosis.verdict import channel_errors, found_effects, judge, not_excited
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Findings:
    """The diagnosis and what it was made from. vehicle: with the effects that were found at their fitted values.

    before, after: (m, 12) residuals on the held-out segments. notes: what the user should know of the data.
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
    result = accepted_fit(regression, selection, dataset)
    before = residuals(vehicle, catalogue, dataset.held_out, regression.noise)
    after = residuals(result.vehicle, catalogue, dataset.held_out, regression.noise)
    left = residuals(result.vehicle, catalogue, dataset.fitted, regression.noise)
    leftover = look(regression, left, places=selection.blows)
    at_first = look(regression, regression.left_over([])) if result.candidates else leftover
    misfits = misfit(before, regression.noise), misfit(after, regression.noise)
    typical = [typical_misfit(rows, regression.noise, regression.rate) for rows in (before, after)]
    effects = found_effects(regression, selection, result)
    gust_share = selection.gust.gain / max(regression.total, 1)
    swings = any(c.effect.hidden and c.effect.rotor_speed is None for c in result.candidates)
    misfits_now = None if swings else (typical[0], typical[1])
    gusty = any(catalogue[effect.name].stochastic for effect in effects)
    verdict = judge(effects, leftover, at_first, misfits_now, gust_share, gusty=gusty)
    unseen = not_excited(regression, selection.chosen)
    apart = [effects[0].name, *effects[0].ambiguous_with] if effects else []
    floor = regression.noise.floor
    diagnosis = Diagnosis(
        verdict=verdict,
        effects=effects,
        channels=channel_errors(before, after, regression, dataset.held_out),
        not_excited=unseen,
        fails_where=worst_cells(regime_maps(dataset.held_out, before, floor, vehicle)),
        next_flight=next_flight(apart, unseen, catalogue),
    )
    return Findings(
        diagnosis, result.vehicle, regression, selection, leftover, before, after, *misfits, dataset.notes
    )  # fmt: skip
