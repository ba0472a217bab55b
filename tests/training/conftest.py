"""Short flights of a vehicle that hides drag and motor lag, flown once for all tests of the room."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest
import torch

from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import parse_effect
from fixtures.planted import noisy, planted_flights
from flights import Flight
from training.config import ModelConfig
from training.data.logged_flights import LoggedFlight, Split, read_logged_flights, split_flights
from training.models import named_kind
from training.plan import Plan, make_plan
from training.recipe import FAST

EFFECTS = ("rotor_drag:coefficient=6e-5", "motor_lag:time_constant=0.04")
MANOEUVRES = (
    "Lemniscate:laps=2,ramp=1,speed=0.9",
    "WarpedEllipse_2:laps=2,ramp=1,speed=0.8",
    "ExtendedLemniscate:laps=2,ramp=1,speed=0.9",
    "circle:laps=2,ramp=1,speed=1.2",
)
MakePlan = Callable[..., Plan]

torch.set_num_threads(1)  # small networks: more threads only wait for each other


@pytest.fixture(scope="session")
def flights(arpl_250g: Vehicle) -> list[Flight]:
    """Four flights of 6 to 10 s with a fifth of the usual noise."""
    uses = [parse_effect(text, 4) for text in EFFECTS]
    return planted_flights(arpl_250g, uses, seed=1, options=noisy(0.2), manoeuvres=MANOEUVRES)


@pytest.fixture(scope="session")
def folder(flights: Sequence[Flight], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as files."""
    folder = tmp_path_factory.mktemp("flights")
    for place, flight in enumerate(flights):
        flight.to_parquet(folder / f"flight_{place}.parquet")
    return folder


@pytest.fixture(scope="session")
def recordings(folder: Path) -> tuple[LoggedFlight, ...]:
    """The same as training reads them."""
    return read_logged_flights(sorted(folder.iterdir()), dt=0.01)


@pytest.fixture(scope="session")
def split(recordings: Sequence[LoggedFlight]) -> Split:
    """The circle validates."""
    return split_flights(recordings, validation="flight_3*")


@pytest.fixture(scope="session")
def plan_for(arpl_250g: Vehicle, split: Split) -> MakePlan:
    """Plans for a kind of model, with changes to its definition and to the recipe."""

    def make(
        kind: str,
        *,
        config: dict[str, Any] | None = None,
        vehicle: Vehicle = arpl_250g,
        seed: int = 0,
        fit: bool = True,
        **recipe: Any,
    ) -> Plan:
        definition: ModelConfig = msgspec.structs.replace(named_kind(kind).config, **(config or {}))
        return make_plan(definition, msgspec.structs.replace(FAST, **recipe), vehicle, split, seed=seed, fit=fit)

    return make
