"""A flight for the likelihood's tests: the rows of a log that the outside simulator made."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from diagnosis.data.dataset import Dataset, read_dataset
from diagnosis.likelihood.columns import candidates
from diagnosis.likelihood.flight_rows import make_rows
from diagnosis.likelihood.problem import Problem
from diagnosis.models.command_effects import with_command_effects
from dynamics.effects import CATALOGUE
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from fixtures.outside_draws import Draw, written


@cache
def flown(kind: str, name: str, seed: int) -> tuple[Vehicle, Dataset]:
    """A draw's vehicle file and its flights."""
    with TemporaryDirectory() as folder:
        logs = written(Draw(kind, name, seed), Path(folder))
        vehicle = read_vehicle(Path(folder) / "vehicle.toml")
        return vehicle, read_dataset(logs, vehicle)


def problem_of(kind: str, name: str, seed: int, flights: int | None = None) -> Problem:
    """The problem of a draw's first flights, with the whole catalogue."""
    vehicle, dataset = flown(kind, name, seed)
    vehicle, catalogue = with_command_effects(vehicle, CATALOGUE, dataset.fitted)
    rows = [make_rows(s, g) for s, g in zip(dataset.fitted, dataset.flight_of, strict=True)][:flights]
    return Problem(vehicle, catalogue, rows, candidates(vehicle, catalogue, dataset.fitted))
