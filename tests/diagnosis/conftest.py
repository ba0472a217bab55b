"""Simulated flights that hide nothing; truths are planted in them by changing the vehicle file or the sensors."""

from collections.abc import Callable

import numpy as np
import pytest

from fixtures.planted import planted_flights
from flights import Flight

MANOEUVRES = (
    "line:laps=3,ramp=1",
    "circle:laps=2,ramp=1,speed=1.2",
    "yaw_spin:laps=3,ramp=1",
    "bob:laps=4,ramp=1,height=0.25",
    "Lemniscate:laps=3,ramp=1.5,speed=0.9",
    "WarpedEllipse_2:laps=3,ramp=1.5,speed=0.8",
)


@pytest.fixture(scope="session")
def plain_flights(arpl_250g) -> list[Flight]:
    """Six flights on a vehicle that its file describes wholly."""
    return planted_flights(arpl_250g, [], seed=3, manoeuvres=MANOEUVRES)


@pytest.fixture(scope="session")
def changed(plain_flights) -> Callable[..., list[Flight]]:
    """The flights with columns replaced by a function of their old values, by name."""

    def make(**columns: Callable[[np.ndarray], np.ndarray]) -> list[Flight]:
        return [with_columns(flight, {n: f(flight[n]) for n, f in columns.items()}) for flight in plain_flights]

    return make


def with_columns(flight: Flight, columns: dict[str, np.ndarray | None]) -> Flight:
    """The flight with other columns; None leaves one out."""
    together = {**flight.columns, **columns}
    present = {name: values for name, values in together.items() if values is not None}
    return Flight(flight.time, present, flight.provenance, flight.origins, flight.parameters, flight.metadata)
