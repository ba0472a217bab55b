"""Common parts of benchmarks of whole flights: a vehicle with its controllers, options, the flights one by one."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import cache
from typing import TypeVar

from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import find_vehicle, read_vehicle
from flights.parallel import parallel_map
from runtime.control.controller import ControllerOptions
from runtime.flight.composition import Controllers, build_controllers

Item = TypeVar("Item")
Flown = TypeVar("Flown")


@cache
def with_controllers(name: str) -> tuple[Vehicle, Controllers]:
    """A bundled vehicle and the controllers of its model at 100 Hz, built once in a process."""
    vehicle = read_vehicle(find_vehicle(name))
    return vehicle, build_controllers(vehicle, None, ControllerOptions.for_vehicle(vehicle, period=0.01))


def options_of(description: str | None, *, flights: int, first_seed: int) -> argparse.ArgumentParser:
    """The options that all have, with these defaults. description: the module's own."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=flights)
    parser.add_argument("--first-seed", type=int, default=first_seed)
    parser.add_argument("--jobs", type=int, default=1)
    return parser


def flown(fly: Callable[[Item], Flown], items: Sequence[Item], *, jobs: int) -> list[Flown]:
    """The results as they are finished, each printed then."""
    results = []
    for _, result in parallel_map(fly, items, jobs=jobs):
        print(result, flush=True)
        results.append(result)
    return results
