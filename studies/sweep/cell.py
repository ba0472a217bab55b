"""One training of a study: what it is, and what became of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import msgspec

from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from training.card import FlightError

At = dict[str, float | str]


class Cell(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """name: of its files. at: its place in the study. model: a kind. config, recipe: what differs from the kind's own.

    prior: factors on the vehicle file's constants (`with_factors`). flights: pattern of the training flights that are
    used. simulated: learns from the flights of a simulation without effects instead. hide_motors: rotor speeds are kept
    from the network.
    """

    name: str
    at: At
    model: str
    seed: int
    config: dict[str, Any] = {}
    recipe: dict[str, Any] = {}
    prior: dict[str, float] = {}
    flights: str = "*"
    simulated: bool = False
    hide_motors: bool = False


class CellResult(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """fingerprint: of everything that decided it. label, true: errors on the test flights.

    validation: mean squared standardised error on the validation flights. seconds: of training. inference: s, of one
    prediction by torch. worker: process that made it. processor: s of processor time of all of the cell, which other
    work on the machine does not lengthen.
    """

    cell: Cell
    fingerprint: str
    label: tuple[FlightError, ...]
    true: tuple[FlightError, ...]
    validation: float
    steps: int
    seconds: float
    inference: float
    worker: str
    processor: float = 0.0

    @property
    def best_known(self) -> tuple[FlightError, ...]:
        """Errors against the truth, or against labels where that is all there is."""
        return self.true or self.label


class FailedCell(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A training that came to nothing. message: why. traceback: where, of an error that no user can cause."""

    cell: Cell
    message: str
    worker: str
    traceback: str = ""


Outcome = CellResult | FailedCell
Placed = TypeVar("Placed", CellResult, Outcome)


class StudyOptions(msgspec.Struct, frozen=True):
    """What is common to the cells of a study. recipe: changes to the recipe, such as steps and batch."""

    seeds: tuple[int, ...]
    recipe: dict[str, Any] = {}


def repeated(
    options: StudyOptions, name: str, at: Mapping[str, float | str], model: str, **changes: Any
) -> tuple[Cell, ...]:
    """A cell for each seed. changes: fields of `Cell`; its recipe's stand over those of the options."""
    recipe = {**options.recipe, **changes.pop("recipe", {})}
    return tuple(
        Cell(f"{name}_seed{seed}", {**at, "seed": float(seed)}, model, seed, recipe=recipe, **changes)
        for seed in options.seeds
    )


def with_factors(vehicle: Vehicle, factors: dict[str, float]) -> Vehicle:
    """The vehicle with constants that are wrong by factors: Jxx, Jyy, Jzz, k_f, k_tau, mass.

    Raises RequestError for another name.
    """
    inertia, body, rotors = list(vehicle.body.inertia), vehicle.body, vehicle.rotors
    for name, factor in factors.items():
        if name in INERTIA:
            inertia[INERTIA.index(name)] *= factor
        elif name == "mass":
            body = msgspec.structs.replace(body, mass=body.mass * factor)
        elif name == "k_f":
            rotors = msgspec.structs.replace(rotors, thrust_constant=rotors.thrust_constant * factor)
        elif name == "k_tau":
            rotors = msgspec.structs.replace(rotors, torque_constant=rotors.torque_constant * factor)
        else:
            raise RequestError(f"unknown constant {name!r}. Known: {', '.join(INERTIA)}, k_f, k_tau, mass.")
    body = msgspec.structs.replace(body)
    msgspec.structs.force_setattr(body, "inertia", tuple(inertia))  # a prior may be wrong beyond what any body can be
    return msgspec.structs.replace(vehicle, body=body, rotors=rotors)


INERTIA = ("Jxx", "Jyy", "Jzz")


def trained(outcomes: Sequence[Outcome]) -> tuple[CellResult, ...]:
    """Those of which there is a model."""
    return tuple(outcome for outcome in outcomes if isinstance(outcome, CellResult))


def grouped(results: Sequence[Placed], *keys: str) -> dict[tuple[float | str, ...], list[Placed]]:
    """Results by their places along some of the study's quantities, in the order in which they come."""
    found: dict[tuple[float | str, ...], list[Placed]] = {}
    for result in results:
        found.setdefault(tuple(result.cell.at[key] for key in keys), []).append(result)
    return found
