"""Tracking on PX4's estimate, in lockstep, and the error of its velocity with and without the runtime's correction.

Flights: hover, Ellipse_1 and Lemniscate of 20 s on px4_sih with the mock's estimator of PX4. By the estimate: what the
runtime sees, and reports. True: from the place of take-off, as the reference counts; the estimate's own error is what
any controller that follows it perfectly would be off by.
Recorded: ULogs of real PX4 firmware with ground truth (SITL, its own EKF).

    python -m benchmarks tracking px4 --recorded FOLDER_OF_ULOGS [--flights 20] [--first-seed 800] [--jobs 1]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.landing.whole_flights import with_controllers
from benchmarks.measurement import Page, add_names, flown, options_of
from benchmarks.px4_estimate import NOT_FLOWN, PERIOD, Errors, mock_errors, recorded_errors, root_mean_square
from dynamics.arrays import Floats
from dynamics.references import named_reference
from dynamics.state import ATTITUDE, POSITION, VELOCITY
from dynamics.vehicle_file import find_vehicle
from runtime.flight.consistent_velocity import ConsistentVelocity
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from runtime.link.estimate import StateEstimate
from simulation.whole_flight import WholeFlight, fly_whole
from sitl_mock.mock import MockOptions
from sitl_mock.vehicle.estimator import Estimator

VEHICLE = "px4_sih"
SECONDS = 20.0
GOALS = {"hover": 0.09, "Ellipse_1": 0.12, "Lemniscate": 0.12}  # m, by the estimate
ON_PX4 = {"hover": "0.125 / 0.386", "Ellipse_1": "0.201 / 0.410", "Lemniscate": "0.140 / 0.821"}


@dataclass(frozen=True)
class Tracked:
    """RMS errors of one flight, m: by the estimate, true, and the estimate's own."""

    name: str
    estimator: Estimator
    by_estimate: float
    true: float
    own: float
    outcome: str


def track(item: tuple[str, Estimator, int]) -> Tracked:
    """Fly one reference once."""
    name, estimator, seed = item
    vehicle, controllers = with_controllers(VEHICLE)
    flight = fly_whole(
        MockOptions(find_vehicle(VEHICLE), estimator=estimator, seed=seed),
        named_reference(name, vehicle, duration=SECONDS),
        plan=Plan(duration=SECONDS, settle=0.3, origin="takeoff"),
        controllers=controllers,
    )
    own = own_error(flight)
    return Tracked(
        name,
        estimator,
        flight.tracking_error(flight.estimate),
        flight.tracking_error(flight.truth),
        own,
        flight.outcome,
    )


def own_error(flight: WholeFlight) -> float:
    """RMS of the estimate's position against the truth while the reference is tracked, m."""
    tracked = np.array([phase is Phase.TRACK for phase in flight.phases])
    error = (np.array(flight.estimate) - np.array(flight.truth))[tracked][:, POSITION]
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def flights_table(flown: Sequence[Tracked]) -> str:
    """The flights in Markdown."""
    lines = [
        "| reference | estimator | flights | by the estimate, mean, worst, m | goal | true, RMS, m "
        "| the estimate's own error, m | true / own | on PX4 before, ours / its own control, m |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, goal in GOALS.items():
        for estimator in ("px4", "mocap"):
            chosen = [one for one in flown if (one.name, one.estimator) == (name, estimator)]
            by_estimate = np.array([one.by_estimate for one in chosen])
            errors = np.array([(one.true, one.own) for one in chosen])
            true, own = root_mean_square(errors)
            lines.append(
                f"| {name} | {estimator} | {len(chosen)} | {by_estimate.mean():.3f}, {by_estimate.max():.3f} "
                f"| {goal:g} | {true:.3f} | {own:.3f} | {true / own:.2f} "
                f"| {ON_PX4[name] if estimator == 'px4' else ''} |"
            )
    others = [
        f"- {one.name} on {one.estimator}: {one.outcome}" for one in flown if one.outcome != "landed and disarmed"
    ]
    return "\n".join([*lines, "", f"Flights that did not end as planned: {len(others)}.", *others])


def velocity_errors(flight: Errors) -> tuple[Floats, Floats]:
    """(3,) RMS errors in flight of the estimated velocity, and of the corrected one, m/s."""
    velocity, corrected = ConsistentVelocity(), np.empty_like(flight.velocity)
    state = np.zeros(13)
    state[ATTITUDE] = [1.0, 0.0, 0.0, 0.0]
    for index, (position, error) in enumerate(zip(flight.position, flight.velocity, strict=True)):
        state[POSITION], state[VELOCITY] = position, error  # of a vehicle at rest: the correction is linear
        estimate = StateEstimate(index * PERIOD, index * PERIOD, state.copy(), 0, True, "ODOMETRY")
        corrected[index] = velocity.correct(estimate, moved=False).velocity_world
    changed = Errors(flight.position, corrected, flight.rotation, flight.height)
    before, now = (np.sqrt(np.mean(one.flying("velocity") ** 2, axis=0)) for one in (flight, changed))
    return np.asarray(before), np.asarray(now)


def velocity_table(sources: dict[str, Sequence[Errors]]) -> str:
    """Errors of the velocity in Markdown."""
    lines = ["| estimate of | flights | velocity, RMS error N, E, D, m/s | corrected |", "| --- | --- | --- | --- |"]
    for name, flights in sources.items():
        both = np.array([velocity_errors(flight) for flight in flights])
        before, now = np.sqrt(np.mean(both**2, axis=0))
        lines.append(f"| {name} | {len(flights)} | {_row(before)} | {_row(now)} |")
    return "\n".join(lines)


def _row(values: Floats) -> str:
    return " ".join(f"{value:.3f}" for value in values)


def px4(words: Sequence[str]) -> Page:
    """Fly, read the recordings, and write the tables."""
    parser = options_of(__doc__, jobs=1, flights=20, first_seed=800)
    parser.add_argument("--recorded", type=Path)
    add_names(parser, "--references", GOALS)
    chosen = parser.parse_args(words)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.flights)
    estimators: tuple[Estimator, ...] = ("px4", "mocap")
    items = [(name, estimator, seed) for name in chosen.references for estimator in estimators for seed in seeds]
    items = [item for item in items if item[1] == "px4" or item[2] < seeds[0] + 2]  # motion capture: all alike
    tracked = flown(track, items, jobs=chosen.jobs)
    sources: dict[str, Sequence[Errors]] = {"the mock": [mock_errors(seed) for seed in seeds[:10]]}
    if chosen.recorded:
        files = [file for file in sorted(chosen.recorded.glob("*.ulg.gz")) if not file.name.startswith(NOT_FLOWN)]
        sources = {"PX4, recorded": [recorded_errors(file) for file in files]} | sources
    text = f"Seeds {seeds[0]} to {seeds[-1]}.\n\n{flights_table(tracked)}\n\n## Velocity\n\n{velocity_table(sources)}"
    return Page("px4_tracking", "Tracking on PX4's estimate", text)
