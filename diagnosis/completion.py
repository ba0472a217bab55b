"""Completing a model: diagnose, take over what lowers the held-out error, diagnose again until nothing more comes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from diagnosis.addition import with_history
from diagnosis.data.dataset import Dataset
from diagnosis.diagnose import Findings, diagnose
from diagnosis.estimation.acceptance import IMPROVEMENT
from diagnosis.report import FoundEffect
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle

MAX_ROUNDS = 3
MIN_SHARE = 0.01  # of the misfit that the first round took away, which a further round must bring


@dataclass(frozen=True, eq=False)
class Completion:
    """vehicle: with everything that was added, the same as before if nothing was. added: in the order of importance.

    first, last: the diagnosis of the vehicle before and after.
    """

    vehicle: Vehicle
    added: tuple[FoundEffect, ...]
    first: Findings
    last: Findings


def complete(
    dataset: Dataset, vehicle: Vehicle, catalogue: Mapping[str, Effect], *, date: str, command: str = ""
) -> Completion:
    """Add what is missing from a vehicle's model: of what a diagnosis names, one effect after another as long as the
    error on held-out flights falls, all fitted jointly. What is left then is diagnosed anew.

    date, command: for the lines of history. Raises DataError when the flights cannot answer.
    """
    first = findings = diagnose(dataset, vehicle, catalogue)
    added: list[FoundEffect] = []
    for _ in range(MAX_ROUNDS):
        news = _missing(findings, vehicle, catalogue)
        gain = findings.misfit_before - findings.misfit_after
        least = MIN_SHARE * (first.misfit_before - first.misfit_after) if added else 0.0
        if not news or gain < least or not findings.misfit_after < IMPROVEMENT * findings.misfit_before:
            break
        action = "added " + ", ".join(_key(effect) for effect in news)
        errors = findings.diagnosis.channels
        vehicle = with_history(findings.vehicle, action, dataset, errors, date=date, command=command)
        added += news
        findings = diagnose(dataset, vehicle, catalogue)
    return Completion(vehicle, tuple(added), first, findings)


def _missing(findings: Findings, vehicle: Vehicle, catalogue: Mapping[str, Effect]) -> list[FoundEffect]:
    """What was found, has a value, and is not in the vehicle file yet."""
    known = {(use.name, use.rotor) for use in vehicle.effects}
    named = findings.diagnosis.effects
    return [e for e in named if not catalogue[e.name].stochastic and (e.name, e.rotor) not in known]


def _key(effect: FoundEffect) -> str:
    return effect.name if effect.rotor is None else f"{effect.name}[{effect.rotor}]"
