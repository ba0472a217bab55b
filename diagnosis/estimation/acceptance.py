"""The effects that are named and those that were taken back."""

from __future__ import annotations

from dataclasses import dataclass

from diagnosis.estimation.fitted import Fit, with_candidates
from diagnosis.estimation.refusal import Reason, Refused
from diagnosis.selection.candidates import Candidate
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Accepted:
    """The effects that are named.

    fit: of them.
    refused: what was likely or taken back, and is not among them.
    """

    fit: Fit
    refused: tuple[Refused, ...]


def refused_of(fitted: Fit, candidate: Candidate, reason: Reason, where: str = "", **detail: float) -> Refused:
    """The refusal of a fitted candidate, with its values."""
    values = {name: e.value for (key, name), e in fitted.estimates.items() if key == candidate.key}
    return Refused(candidate.effect.name, candidate.rotor, reason, detail, where, values)


def with_faults_of(fitted: Fit, vehicle: Vehicle) -> Vehicle:
    """A vehicle with the sensors' faults of a fit, which do not move it, so that both predict the same motion."""
    faults = [c for c in fitted.candidates if not c.effect.moves_vehicle]
    values = {f"{key}.{name}": estimate.value for (key, name), estimate in fitted.estimates.items()}
    return with_candidates(vehicle, faults, values)


def with_nuisances_of(fitted: Fit, vehicle: Vehicle) -> Vehicle:
    """Vehicle with the effects between command and thrust as in the fit.

    A gain that moves within its own deviation, as it does beside any effect, moves the open loop by that much: what
    rises against this vehicle as well is the effects' doing.
    """
    faults = [c for c in fitted.candidates if not c.effect.moves_vehicle]
    values = {f"{key}.{name}": value for (key, name), value in fitted.values.items()}
    return with_candidates(vehicle, [*faults, *fitted.nuisances], values)
