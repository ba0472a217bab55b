"""What a checkpoint says of itself: from which flights it was trained, how, and how far it can be trusted."""

from __future__ import annotations

import msgspec

from training.recipe import Recipe


class FlightError(msgspec.Struct, frozen=True):
    """RMSE on one flight against its labels, each component counting alike: m/s^2, rad/s^2, and both together.

    nominal: of the textbook model, both together. base: of what the network's output is added to, if anything.
    """

    flight: str
    rows: int
    linear: float
    angular: float
    combined: float
    nominal: float
    base: float | None = None


class Card(msgspec.Struct, frozen=True):
    """The model card. flights, validation: sha256 by file name. seeds, steps, best_step, seconds: one a member.

    errors: of the ensemble's mean on the validation flights. ranges: least and greatest value of each input in
    training.
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
