"""One training of a study, a cell, and its outcome."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import msgspec

from dynamics.errors import RequestError
from dynamics.vehicle import Body, Vehicle
from training.card import FlightError

At = dict[str, float | str]


class Cell(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One training of a study.

    name: of its files.
    at: its place along the study's quantities.
    model: kind of network.
    config, recipe: overrides of the kind's own.
    prior: factors on the vehicle file's constants (`with_factors`).
    flights: pattern of the training flights.
    simulated: whether it is trained on the flights of a simulation without effects instead.
    hide_motors: whether rotor speeds are removed from the network's inputs.
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
    """The result of a cell.

    fingerprint: of everything that decides it.
    label, true: errors on the test flights, against labels and against ground truth.
    validation: mean squared standardised error on the validation flights.
    steps: of the optimiser.
    seconds: of training.
    inference: s of one prediction by torch.
    worker: machine and process.
    processor: s of processor time of the whole cell, which other work on the machine does not lengthen.
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
        """Errors against ground truth, or against labels without any."""
        return self.true or self.label


class FailedCell(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A cell whose training failed.

    message: for people.
    traceback: of an error that no user can cause.
    """

    cell: Cell
    message: str
    worker: str
    traceback: str = ""


Outcome = CellResult | FailedCell
Placed = TypeVar("Placed", CellResult, Outcome)


class StudyOptions(msgspec.Struct, frozen=True):
    """Settings that all cells of a study share.

    seeds: of the trainings of each cell.
    recipe: overrides, such as steps and batch.
    """

    seeds: tuple[int, ...]
    recipe: dict[str, Any] = {}


def repeated(
    options: StudyOptions, name: str, at: Mapping[str, float | str], model: str, **fields: Any
) -> tuple[Cell, ...]:
    """A cell for each seed. fields: of `Cell`; its recipe overrides that of the options."""
    recipe = {**options.recipe, **fields.pop("recipe", {})}
    return tuple(
        Cell(f"{name}_seed{seed}", {**at, "seed": float(seed)}, model, seed, recipe=recipe, **fields)
        for seed in options.seeds
    )


class PriorBody(Body, frozen=True, forbid_unknown_fields=True):
    """A body as a wrong prior has it: its inertia may be one that no distribution of mass has."""

    def __post_init__(self) -> None:
        """Accept any inertia."""


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
    prior = PriorBody(body.mass, (inertia[0], inertia[1], inertia[2]), body.centre_of_mass)
    return msgspec.structs.replace(vehicle, body=prior, rotors=rotors)


INERTIA = ("Jxx", "Jyy", "Jzz")


def trained(outcomes: Sequence[Outcome]) -> tuple[CellResult, ...]:
    """The cells that were trained."""
    return tuple(outcome for outcome in outcomes if isinstance(outcome, CellResult))


def grouped(results: Sequence[Placed], *keys: str) -> dict[tuple[float | str, ...], list[Placed]]:
    """Results by their places along some of the study's quantities, in the order of their first appearance."""
    groups: dict[tuple[float | str, ...], list[Placed]] = {}
    for result in results:
        groups.setdefault(tuple(result.cell.at[key] for key in keys), []).append(result)
    return groups
