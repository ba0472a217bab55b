"""Flights whose estimate has the wrong height at the start: how many touch the ground between take-off and landing.

Circles in lockstep on px4_sih with the mock's estimator of PX4, which has the height wrong by up to 1.5 m before
take-off and lets it wander on by decimetres; the reference counts from where the vehicle stands.

    python -m benchmarks landing start_height [--flights 500] [--height 2] [--first-seed 20000] [--jobs 1]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite

import numpy as np

from benchmarks.landing.whole_flights import with_controllers
from benchmarks.measurement import Page, flown, options_of
from dynamics.references import named_reference
from dynamics.vehicle_file import find_vehicle
from runtime.flight.mission import Plan
from simulation.whole_flight import fly_whole
from sitl_mock.mock import MockOptions

VEHICLE, SECONDS, WORST = "px4_sih", 5.0, 1.5  # s, m


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
    vehicle, controllers = with_controllers(VEHICLE)
    error = float(np.random.default_rng(seed).uniform(-WORST, WORST))
    flight = fly_whole(
        MockOptions(find_vehicle(VEHICLE), seed=seed, start_height_error=error),
        named_reference(f"circle:height={height:g}", vehicle, duration=SECONDS),
        plan=Plan(height=height, duration=SECONDS, speed=2.5, acceleration=3.0, settle=0.2, origin="takeoff"),
        controllers=controllers,
    )
    lowest = min((flight.clearance[tick] for tick in flight.aloft), default=0.0)
    return Started(seed, error, isfinite(flight.touched), lowest, flight.outcome)


def table(flights: Sequence[Started], height: float) -> str:
    """All flights in Markdown."""
    lowest = np.array([one.lowest for one in flights])
    lines = [
        "| reference, m | flights | touched the ground | lowest clearance, median, 5 %, worst, m |",
        "| --- | --- | --- | --- |",
        f"| {height:g} | {len(flights)} | {sum(one.touched for one in flights)} "
        f"| {np.median(lowest):.2f}, {np.quantile(lowest, 0.05):.2f}, {lowest.min():.2f} |",
    ]
    others = [f"- {one}" for one in flights if one.outcome != "landed and disarmed"]
    return "\n".join([*lines, "", f"Flights that did not end as planned: {len(others)}.", *others])


def start_height(words: Sequence[str]) -> Page:
    """Fly many circles and write the table."""
    parser = options_of(__doc__, jobs=1, flights=500, first_seed=20000)
    parser.add_argument("--height", type=float, default=2.0)
    chosen = parser.parse_args(words)
    seeds = list(range(chosen.first_seed, chosen.first_seed + chosen.flights))
    flights = flown(partial(fly, height=chosen.height), seeds, jobs=chosen.jobs)
    note = f"Seeds {seeds[0]} to {seeds[-1]}. Real PX4, before heights counted from the ground: 4 of 86 touched it."
    return Page(
        "start_height", "Flights with a wrong height at the start", f"{note}\n\n{table(flights, chosen.height)}"
    )
