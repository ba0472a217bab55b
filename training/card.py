"""The model card: flights, recipe, errors and versions of a training."""

from __future__ import annotations

import math

import msgspec

from training.recipe import Recipe


class FlightError(msgspec.Struct, frozen=True):
    """RMSE on one flight against its labels, each component counting alike.

    flight: its name.
    rows: compared.
    linear: m/s^2.
    angular: rad/s^2.
    combined: over all six components.
    nominal: of the nominal model, combined.
    base: of what the network's output is added to, combined, None without a base.
    """

    flight: str
    rows: int
    linear: float
    angular: float
    combined: float
    nominal: float
    base: float | None = None


class Card(msgspec.Struct, frozen=True):
    """The model card.

    kind: of model (`training.models`).
    command, date, recipe: of the training.
    flights, validation: sha256 by file name.
    vehicle, vehicle_sha256: name and hash of the vehicle file.
    seeds, steps, best_step, seconds: one a member.
    parameters: of one network.
    rows: windows of the training flights.
    errors: of the ensemble's mean on the validation flights.
    ranges: lowest and highest value of each input in training, SI units.
    versions: of alula and the libraries.
    notes: what the user should know.
    """

    kind: str
    command: str
    date: str
    recipe: Recipe
    flights: dict[str, str]
    validation: dict[str, str]
    vehicle: str
    vehicle_sha256: str
    seeds: tuple[int, ...] = ()
    steps: tuple[int, ...] = ()
    best_step: tuple[int, ...] = ()
    seconds: tuple[float, ...] = ()
    parameters: int = 0
    rows: int = 0
    errors: tuple[FlightError, ...] = ()
    ranges: dict[str, tuple[float, float]] = {}
    versions: dict[str, str] = {}
    notes: tuple[str, ...] = ()

    @property
    def of_nominal(self) -> float:
        """RMSE on all validation flights over that of the nominal model; NaN without any, above 1 where it is worse."""
        own, nominal = (
            sum(error.rows * combined**2 for error, combined in pairs)
            for pairs in ([(e, e.combined) for e in self.errors], [(e, e.nominal) for e in self.errors])
        )
        return math.sqrt(own / nominal) if nominal > 0 else math.nan
