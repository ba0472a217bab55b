"""From flights and a vehicle to a verdict: which physical effect is missing, or that none in the catalogue fits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from diagnosis.data.data_checks import require_answerable
from diagnosis.data.dataset import Dataset
from diagnosis.estimation.acceptance import Accepted, accepted_fit
from diagnosis.estimation.command_gain import command_gain
from diagnosis.estimation.equation_error import Fit, fit
from diagnosis.estimation.evaluation import (
    reduced_chi_square,
    residuals_in,
    sensors_floor,
    telling_channels,
    typical_chi_square,
)
from diagnosis.estimation.joint_search import search_jointly
from diagnosis.leftover import leftover, with_typical_window
from diagnosis.models.command_effects import without_command_effects
from diagnosis.next_flight import next_flight
from diagnosis.regimes import regime_maps, worst_cells
from diagnosis.report import Diagnosis, MissingEffect
from diagnosis.selection.regression import Regression, make_regression
from diagnosis.selection.residual_tests import Rejection, ResidualTests, run_residual_tests
from diagnosis.selection.search import Selection
from diagnosis.thresholds import DEFAULT, Thresholds
from diagnosis.verdict import channel_errors, considered, judge, missing_effects, not_excited, rejections
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class DiagnosisDetails:
    """A diagnosis and what it was made from.

    diagnosis: the answer.
    vehicle: with the missing effects at their fitted values.
    regression, selection: of the fitted flights.
    accepted: which of the selected effects are named, and why the others are not.
    residual_tests: of the identified model on the fitted flights.
    before, after: (m, 12) residuals on the held-out segments.
    chi_square_before, chi_square_after: reduced, of the same.
    notes: what the user should know of the data.
    """

    diagnosis: Diagnosis
    vehicle: Vehicle
    regression: Regression
    selection: Selection
    accepted: Accepted
    residual_tests: ResidualTests
    before: list[Floats]
    after: list[Floats]
    chi_square_before: float
    chi_square_after: float
    notes: tuple[str, ...]


def diagnose_dataset(
    dataset: Dataset, vehicle: Vehicle, catalogue: Mapping[str, Effect], thresholds: Thresholds = DEFAULT
) -> DiagnosisDetails:
    """Name the physical effect that is missing from a vehicle's model.

    thresholds: all but those that are applied when flights are read. Raises DataError when the flights cannot answer.
    """
    require_answerable(dataset.everything, vehicle, thresholds)
    regression = make_regression(vehicle, catalogue, dataset.fitted, dataset.flight_of, thresholds)
    regression, selection = search_jointly(regression)
    accepted = accepted_fit(regression, selection, dataset)
    present = fit(regression, ()).vehicle  # with the gain of commands that fits without further effects
    before, after = (residuals_in(regression, v, dataset.held_out) for v in (present, accepted.fit.vehicle))
    tests = run_residual_tests(
        regression,
        residuals_in(regression, accepted.fit.vehicle, dataset.fitted),
        by_position=selection.gust_detected,
    )
    tests = with_typical_window(tests, after, accepted.floor, telling_channels(regression))
    effects = missing_effects(regression, selection, accepted)
    quiet = not_excited(regression, selection.chosen)
    maps = regime_maps(dataset.held_out, before, accepted.floor, vehicle, thresholds.regimes)
    sensors = sensors_floor(regression, accepted.fit.vehicle, dataset.held_out, accepted.floor)
    rejected = _rejected(regression, selection, accepted.fit, effects, tests, before, after)
    left = leftover(rejected, tests, dataset.fitted, dataset.held_out, vehicle, thresholds.regimes)
    diagnosis = Diagnosis(
        verdict=judge(effects, rejected),
        effects=effects,
        channels=channel_errors(before, after, accepted.floor, sensors),
        not_excited=quiet,
        fails_where=worst_cells(maps, thresholds.regimes),
        next_flight=next_flight(effects, left, accepted.refused, quiet, catalogue),
        refused=accepted.refused,
        candidates=considered(selection, effects, accepted.refused),
        leftover=left,
    )
    return DiagnosisDetails(
        diagnosis=diagnosis,
        vehicle=without_command_effects(accepted.fit.vehicle),
        regression=regression,
        selection=selection,
        accepted=accepted,
        residual_tests=tests,
        before=before,
        after=after,
        chi_square_before=reduced_chi_square(before, regression.noise),
        chi_square_after=reduced_chi_square(after, regression.noise),
        notes=(*_notes(dataset, accepted.fit), *_not_followed(regression)),
    )


def _not_followed(regression: Regression) -> list[str]:
    """A note on effects that these logs are too slow for."""
    if not regression.not_followed:
        return []
    names, rate = ", ".join(regression.not_followed), regression.segments[0].rate
    return [f"not tried, since logs of {rate:.0f} Hz are too slow for its hidden states: {names}"]


def _notes(dataset: Dataset, accepted: Fit) -> tuple[str, ...]:
    """The data set's notes, that on commands with the gain of the joint fit."""
    gain = None if dataset.curve is None else command_gain(accepted, dataset.curve.mass)
    if dataset.curve is None or gain is None:
        return dataset.notes
    first, fitted = dataset.curve.note(), dataset.curve.note(gain.value, gain.std)
    return tuple(fitted if note == first else note for note in dataset.notes)


def _rejected(
    regression: Regression,
    selection: Selection,
    accepted: Fit,
    effects: tuple[MissingEffect, ...],
    tests: ResidualTests,
    before: list[Floats],
    after: list[Floats],
) -> tuple[Rejection, ...]:
    """The residual tests that reject, and that by typical held-out windows unless the model has a swinging load."""
    tests_before = run_residual_tests(regression, regression.residuals_after([])) if accepted.candidates else tests
    swinging = any(c.effect.hidden and c.effect.rotor_speed is None for c in accepted.candidates)
    typical = None if swinging else (typical_chi_square(before, regression), typical_chi_square(after, regression))
    gust_share = selection.gust.gain / max(regression.total, 1)
    gusty = any(regression.catalogue[effect.name].stochastic for effect in effects)
    thresholds = regression.thresholds.verdict
    return rejections(tests, tests_before, typical, gust_share, gusty=gusty, thresholds=thresholds)
