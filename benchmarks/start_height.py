"""Flights whose estimate has the wrong height at the start: how many touch the ground between take-off and landing.

Circles in lockstep on px4_sih with the mock's estimator of PX4, which has the height wrong by up to 1.5 m before
take-off and lets it wander on by decimetres; the reference counts from where the vehicle stands.

    python -m benchmarks.start_height [--flights 500] [--height 2] [--first-seed 20000] [--jobs 1]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite

import numpy as np

from benchmarks.provenance import write_result
from dynamics.references import named_reference
from dynamics.vehicle_file import read_vehicle
from flights.parallel import parallel_map
from runtime.control.controller import ControllerOptions
from runtime.flight.composition import Controllers, build_controllers
from runtime.flight.mission import Plan
from simulation.whole_flight import fly_whole
from sitl_mock.mock import MockOptions
from vehicles import FOLDER

FILE, SECONDS, WORST = FOLDER / "px4_sih.toml", 5.0, 1.5  # s, m
_controllers: list[Controllers] = []


@dataclass(frozen=True)
class Started:
    """One flight. error: of the height at the start, m. lowest: true clearance between take-off and landing, m."""

    seed: int
    error: float
    touched: bool
    lowest: float
    outcome: str


def fly(seed: int, height: float) -> Started:
    """Fly one circle. height: of the reference, m."""
    vehicle = read_vehicle(FILE)
    if not _controllers:
        _controllers.append(build_controllers(vehicle, None, ControllerOptions.for_vehicle(vehicle, period=0.01)))
    error = float(np.random.default_rng(seed).uniform(-WORST, WORST))
    flight = fly_whole(
        MockOptions(FILE, seed=seed, start_height_error=error),
        named_reference(f"circle:height={height:g}", vehicle, duration=SECONDS),
        plan=Plan(height=height, duration=SECONDS, speed=2.5, acceleration=3.0, settle=0.2, origin="takeoff"),
        controllers=_controllers[0],
    )
    lowest = min((flight.clearance[tick] for tick in flight.aloft), default=0.0)
    return Started(seed, error, isfinite(flight.touched), lowest, flight.outcome)


def table(flown: Sequence[Started], height: float) -> str:
    """All flights in Markdown."""
    lowest = np.array([one.lowest for one in flown])
    lines = [
        "| reference, m | flights | touched the ground | lowest clearance, median, 5 %, worst, m |",
        "| --- | --- | --- | --- |",
        f"| {height:g} | {len(flown)} | {sum(one.touched for one in flown)} "
        f"| {np.median(lowest):.2f}, {np.quantile(lowest, 0.05):.2f}, {lowest.min():.2f} |",
    ]
    others = [f"- {one}" for one in flown if one.outcome != "landed and disarmed"]
    return "\n".join([*lines, "", f"Flights that did not end as planned: {len(others)}.", *others])


def main() -> None:
    """Fly many circles and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=500)
    parser.add_argument("--height", type=float, default=2.0)
    parser.add_argument("--first-seed", type=int, default=20000)
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args()
    seeds = list(range(chosen.first_seed, chosen.first_seed + chosen.flights))
    flown = []
    for _, one in parallel_map(partial(fly, height=chosen.height), seeds, jobs=chosen.jobs):
        print(one, flush=True)
        flown.append(one)
    note = f"Seeds {seeds[0]} to {seeds[-1]}. Real PX4, before heights counted from the ground: 4 of 86 touched it."
    write_result("start_height", "Flights with a wrong height at the start", f"{note}\n\n{table(flown, chosen.height)}")


if __name__ == "__main__":
    main()
