"""Completing a model: diagnose, add the effects that lower the held-out error, and repeat while it falls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from diagnosis.addition import with_history
from diagnosis.data.dataset import Dataset
from diagnosis.diagnose import DiagnosisDetails, diagnose_dataset
from diagnosis.report import MissingEffect
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.effect import Effect
from dynamics.rate_loop import with_gains_kept
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Completion:
    """A vehicle's model with what was missing.

    vehicle: with everything that was added, the same as before if nothing was.
    added: in the order of importance.
    first, last: the diagnosis of the vehicle before and after.
    """

    vehicle: Vehicle
    added: tuple[MissingEffect, ...]
    first: DiagnosisDetails
    last: DiagnosisDetails


def complete(
    dataset: Dataset,
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    *,
    date: str,
    command: str = "",
    thresholds: Thresholds = DEFAULT,
) -> Completion:
    """Add what is missing from a vehicle's model: the effects that a diagnosis names, all fitted jointly, round by
    round as long as the error on held-out flights falls. The completed model is diagnosed once more.

    date, command: for the lines of history. Raises DataError when the flights cannot answer.
    """
    first = result = diagnose_dataset(dataset, vehicle, catalogue, thresholds)
    added: list[MissingEffect] = []
    for _ in range(thresholds.completion.max_rounds):
        missing = _missing(result, vehicle, catalogue)
        gain = result.chi_square_before - result.chi_square_after
        required = (
            thresholds.completion.min_share * (first.chi_square_before - first.chi_square_after) if added else 0.0
        )
        falls = result.chi_square_after < thresholds.acceptance.max_ratio * result.chi_square_before
        if not missing or gain < required or not falls:
            break
        action = "added " + ", ".join(_key(effect) for effect in missing)
        errors = result.diagnosis.channels
        vehicle = with_history(
            with_gains_kept(vehicle, result.vehicle, catalogue), action, dataset, errors, date=date, command=command
        )
        added += missing
        result = diagnose_dataset(dataset, vehicle, catalogue, thresholds)
    return Completion(vehicle, tuple(added), first, result)


def _missing(result: DiagnosisDetails, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> list[MissingEffect]:
    """The effects of a diagnosis that have a value and are not in the vehicle file yet."""
    own = {(use.name, use.rotor) for use in vehicle.effects}
    named = result.diagnosis.effects
    return [e for e in named if not catalogue[e.name].stochastic and (e.name, e.rotor) not in own]


def _key(effect: MissingEffect) -> str:
    return effect.name if effect.rotor is None else f"{effect.name}[{effect.rotor}]"
