"""Crashes: false alarms in hard flights, and the time until a true crash is noticed.

Whole flights in lockstep on the mock's vehicles, px4_sih with PX4's estimator and arpl_250g in motion capture. Hard:
every manoeuvre as fast as the vehicle can fly it, with effects hidden from the controller (twice the drag, a quarter
more or less mass, a slower motor, wind with gusts). Crashes: a circle in the coordinates of an estimate whose height is
too large, which leads into the ground, and a hand that seizes the vehicle in flight. Noticed: the first event of a
crash after the true contact.

    python -m benchmarks landing crashes [--flights 500] [--crashes 40] [--first-seed 9000] [--jobs 1]
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.landing.whole_flights import with_controllers
from benchmarks.measurement import Page, flown, options_of
from dynamics.errors import RequestError
from dynamics.references import Reference, check_feasibility, named_reference
from dynamics.references.catalogue import MANOEUVRES
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import find_vehicle
from runtime.flight.events import Event
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from simulation.whole_flight import Lockstep, fly_whole
from sitl_mock.mock import MockOptions

VEHICLES = ("px4_sih", "arpl_250g")
HIDDEN: dict[str, Sequence[str]] = {
    "nothing": (),
    "drag": ("linear_drag:coefficient={drag}",),
    "heavy": ("mass:ratio=1.25",),
    "light": ("mass:ratio=0.8",),
    "slow motors": ("motor_lag:time_constant=0.09",),
    "wind": ("wind:x=3,y=2", "gust:intensity=1.0"),
}
DRAG = {"px4_sih": 2.0, "arpl_250g": 0.2}  # N s/m
SPEEDS = (1.0, 0.85, 0.7, 0.55, 0.4, 0.3)
HEIGHT, SECONDS, PATIENCE = 3.0, 8.0, 60.0  # m, s of a manoeuvre, s
ALARMS = (
    Event.IMPACT,
    Event.GROUND_CONTACT,
    Event.OVERTURNED,
    Event.HELD,
    Event.TRACKING_LOST,
    Event.CRASHED,
)
NOTICED = (*ALARMS, Event.SETPOINT_REFUSED)  # that a hand holds its attitude as well


@dataclass(frozen=True)
class Hard:
    """A hard flight.

    alarms: events of a crash that were raised.
    touched: whether it met the ground in the air.
    landed: whether it ended by the runtime's own landing.
    """

    seed: int
    what: str
    speed: float
    alarms: tuple[str, ...]
    touched: bool
    landed: bool
    outcome: str


@dataclass(frozen=True)
class Crash:
    """A crash. noticed, stopped: s from the contact until an event, and until thrust is gone for good."""

    seed: int
    what: str
    noticed: float
    stopped: float
    outcome: str
    events: tuple[str, ...] = field(default_factory=tuple)


def fastest(name: str, vehicle: Vehicle) -> Reference | None:
    """A manoeuvre as fast as the vehicle can fly it, None if it cannot."""
    for speed in SPEEDS:
        try:
            reference = named_reference(f"{name}:speed={speed:g},height={HEIGHT:g}", vehicle, duration=SECONDS)
            check_feasibility(reference, vehicle).require()
        except RequestError:
            continue
        return reference
    return None


def hard_flight(seed: int) -> Hard | None:
    """One hard flight, None where the vehicle cannot fly the manoeuvre."""
    random = np.random.default_rng(seed)
    name = VEHICLES[seed % len(VEHICLES)]
    vehicle, built = with_controllers(name)
    manoeuvre = list(MANOEUVRES)[int(random.integers(len(MANOEUVRES)))]
    hidden = list(HIDDEN)[int(random.integers(len(HIDDEN)))]
    reference = fastest(manoeuvre, vehicle)
    if reference is None:
        return None
    flight = fly_whole(
        MockOptions(
            find_vehicle(name), effects=tuple(text.format(drag=DRAG[name]) for text in HIDDEN[hidden]), seed=seed
        ),
        reference,
        plan=Plan(height=HEIGHT, duration=SECONDS, speed=2.5, acceleration=3.0, settle=0.3, origin="takeoff"),
        controllers=built,
        limit=PATIENCE,
    )
    speed = float(np.linalg.norm(reference.states(np.arange(0.0, SECONDS, 0.02))[:, 3:6], axis=1).max())
    alarms = tuple(event.value for _, event, _ in flight.events if event in ALARMS)
    touched = bool(np.isfinite(flight.touched))
    return Hard(seed, f"{name}, {manoeuvre}, {hidden}", speed, alarms, touched, flight.landed, flight.outcome)


def crash(seed: int) -> Crash:
    """One crash: into the ground, or into a hand."""
    random = np.random.default_rng(seed)
    vehicle, built = with_controllers("px4_sih")
    seized = seed % 2 == 1
    # the estimate's height at the start, so that a circle at 1 m in its coordinates lies below the ground
    error = 0.0 if seized else float(random.uniform(1.1, 1.6))
    at = random.uniform(3.0, 6.0)
    held: list[float] = []

    def hand(flown: Lockstep) -> None:
        mission, time = flown.flyer.mission, flown.autopilot.time
        if seized and not held and mission.phase is Phase.TRACK and time - mission.phase_started > at:
            flown.vehicle.hold(True)
            held.append(time)

    flight = fly_whole(
        MockOptions(find_vehicle("px4_sih"), start_height_error=error, seed=seed),
        named_reference("circle:height=1", vehicle, duration=SECONDS),
        plan=Plan(height=HEIGHT if seized else 1.5, duration=SECONDS, origin="takeoff" if seized else "estimate"),
        controllers=built,
        watch=hand,
        limit=PATIENCE,
    )
    contact = held[0] if held else flight.touched
    noticed = [time for time, event, _ in flight.events if event in NOTICED and time >= contact]
    running = [time for time, thrust in zip(flight.time, flight.thrust, strict=True) if thrust > 0.05 * vehicle.weight]
    what = "seized by a hand" if seized else "circle into the ground"
    return Crash(
        seed,
        what,
        min(noticed, default=np.inf) - contact,
        max(running) - contact,
        flight.outcome,
        tuple(event.value for _, event, _ in flight.events),
    )


def early(flights: Sequence[Hard]) -> list[str]:
    """Flights that ended early, by vehicle, hidden effect and outcome."""
    alike: dict[tuple[str, str], list[Hard]] = {}
    for one in flights:
        vehicle, _, hidden = one.what.split(", ")
        alike.setdefault((f"{vehicle}, {hidden}", re.sub(r" by [\d.]+", "", one.outcome)), []).append(one)
    return [
        f"- {len(some)} of {what}, seed {some[0].seed} the first: {outcome}" for (what, outcome), some in alike.items()
    ]


def report(hard: Sequence[Hard], crashes: Sequence[Crash]) -> str:
    """Both tables in Markdown."""
    airborne = [one for one in hard if not one.touched]
    alarmed = [one for one in airborne if one.alarms]
    lines = [
        f"{len(hard)} hard flights, up to {max(one.speed for one in hard):.1f} m/s; {len(hard) - len(airborne)} of "
        f"them touched the ground. False alarms in the others: **{len(alarmed)}**.",
        *[f"- seed {one.seed}, {one.what}: {', '.join(one.alarms)}" for one in alarmed],
        "",
        "Flights that ended early without one:",
        *early([one for one in airborne if not one.alarms and not one.landed]),
        "",
        "| crash | flights | noticed after, median, worst, s | thrust gone after, median, worst, s | unnoticed |",
        "| --- | --- | --- | --- | --- |",
    ]
    for what in sorted({one.what for one in crashes}):
        met = [one for one in crashes if one.what == what and np.isfinite(one.stopped)]
        if not met:
            lines.append(f"| {what} | 0 | - | - | - |")
            continue
        noticed, stopped = (np.array([getattr(one, name) for one in met]) for name in ("noticed", "stopped"))
        unnoticed = int(np.sum(~np.isfinite(noticed)))
        lines.append(
            f"| {what} | {len(met)} | {np.median(noticed):.2f}, {noticed.max():.2f} "
            f"| {np.median(stopped):.2f}, {stopped.max():.2f} | {unnoticed} |"
        )
    return "\n".join(lines)


def crashes(words: Sequence[str]) -> Page:
    """Fly, crash and write the tables."""
    parser = options_of(__doc__, jobs=1, flights=500, first_seed=9000)
    parser.add_argument("--crashes", type=int, default=40)
    chosen = parser.parse_args(words)
    first = chosen.first_seed
    crashes = flown(crash, range(first, first + chosen.crashes), jobs=chosen.jobs)
    flights = flown(hard_flight, range(first, first + chosen.flights), jobs=chosen.jobs)
    hard = [one for one in flights if one is not None]
    return Page("crash_detector", "Crashes noticed, and false alarms", report(hard, crashes))
