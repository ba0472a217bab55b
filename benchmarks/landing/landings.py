"""Landings on PX4's estimate: tilt after contact, time until the motors stand still and the vehicle is disarmed.

Whole flights in lockstep on the mock's vehicle with PX4's estimator, whose height is wrong from the start and drifts
on, over ground of five kinds. The autopilot refuses to disarm until its own land detector agrees. Tilt is true, from
the last contact on, and on a slope what exceeds the slope. Beside it the tilt of the half second before the contact
and from half a second after it on: in wind a vehicle hovers and touches down leaning.

    python -m benchmarks landing landings [--flights 200] [--first-seed 7000] [--jobs 1]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, inf, isfinite, radians

import msgspec
import numpy as np

from benchmarks.landing.whole_flights import with_controllers
from benchmarks.measurement import Page, flown, options_of
from dynamics.references import named_reference
from dynamics.vehicle_file import find_vehicle
from runtime.flight.events import Event
from runtime.flight.mission import Plan
from simulation.whole_flight import fly_whole
from sitl_mock.mock import MockOptions
from sitl_mock.scenario import Scenario
from sitl_mock.vehicle.ground import Ground

VEHICLE, REFERENCE, PATIENCE = "px4_sih", "hover:laps=1,height=1.2", 90.0  # s
KINDS = ("flat", "windy", "sloped", "hard", "moving deck")
PLAN = Plan(height=1.2, duration=1.0, speed=2.5, acceleration=3.0, settle=0.3, origin="takeoff")
HARD = 0.8  # m/s
STANDING = 0.05  # of the weight, thrust below which the motors count as stopped


@dataclass(frozen=True)
class Landing:
    """One landing. before, tilt, settled: degrees, mean of the 0.5 s before contact, from it on, from 0.5 s later on.

    motors, disarmed: s from contact. caught: false contacts.
    """

    seed: int
    kind: str
    before: float
    tilt: float
    settled: float
    motors: float
    disarmed: float
    caught: int
    outcome: str


def surroundings(kind: str, random: np.random.Generator) -> tuple[Ground, tuple[str, ...]]:
    """Ground and air of a kind of landing."""
    direction, size = random.uniform(0, 2 * np.pi), random.uniform()
    match kind:
        case "windy":
            east, north = (1.0 + 4.0 * size) * np.array([np.cos(direction), np.sin(direction)])
            return Ground(kind="sih"), (f"wind:x={east:.2f},y={north:.2f}", f"gust:intensity={0.3 + 0.7 * size:.2f}")
        case "sloped":
            return Ground(kind="legs", slope=radians(3.0 + 12.0 * size), uphill=direction), ()
        case "hard":
            return Ground(kind="legs"), ()
        case "moving deck":
            speed = (0.4 * size * np.cos(direction), 0.4 * size * np.sin(direction))
            return Ground(kind="legs", heave=0.05 + 0.2 * size, heave_period=5.0, speed=speed), ()
        case _:
            return Ground(kind="sih"), ()


def land(seed: int) -> Landing:
    """Fly and land once."""
    vehicle, controllers = with_controllers(VEHICLE)
    kind = KINDS[seed % len(KINDS)]
    ground, effects = surroundings(kind, np.random.default_rng(seed))
    flight = fly_whole(
        MockOptions(find_vehicle(VEHICLE), effects=effects, scenario=Scenario(ground=ground), seed=seed),
        named_reference(REFERENCE, vehicle),
        plan=msgspec.structs.replace(PLAN, touchdown=HARD) if kind == "hard" else PLAN,
        controllers=controllers,
        limit=PATIENCE,
    )
    contact, tilt = min(flight.contact, len(flight.time) - 1), flight.tilt
    since = np.array(flight.time) - flight.time[contact]
    running = since[np.array(flight.thrust) > STANDING * vehicle.weight]
    planned = flight.landed and not flight.landing_reason
    return Landing(
        seed,
        kind,
        degrees(float(tilt[(since > -0.5) & (since < 0.0)].mean())),
        degrees(max(0.0, float(tilt[since >= 0.0].max()) - ground.slope)),
        degrees(max(0.0, float(tilt[since > 0.5].max(initial=0.0)) - ground.slope)),
        max(float(running.max(initial=0.0)), 0.0),
        flight.disarmed - flight.time[contact] if isfinite(flight.disarmed) else inf,
        len(flight.times(Event.CONTACT_LOST)),
        "" if planned else flight.landing_reason or flight.outcome,
    )


def table(landings: Sequence[Landing]) -> str:
    """All kinds in Markdown."""
    lines = [
        "| ground | landings | tilt before contact, median, worst, degrees | after it, median, 95 %, worst "
        "| from 0.5 s on, worst | thrust below 5 %, median, worst, s | disarmed, median, worst, s "
        "| contacts that were none |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for kind in ("all", *KINDS):
        chosen = [one for one in landings if kind in ("all", one.kind)]
        if not chosen:
            continue
        before, tilt = (np.array([getattr(one, name) for one in chosen]) for name in ("before", "tilt"))
        motors, disarmed = (np.array([getattr(one, name) for one in chosen]) for name in ("motors", "disarmed"))
        lines.append(
            f"| {kind} | {len(chosen)} | {np.median(before):.1f}, {before.max():.1f} "
            f"| {np.median(tilt):.1f}, {np.quantile(tilt, 0.95):.1f}, {tilt.max():.1f} "
            f"| {max(one.settled for one in chosen):.1f} "
            f"| {np.median(motors):.2f}, {motors.max():.2f} | {np.median(disarmed):.1f}, {disarmed.max():.1f} "
            f"| {sum(one.caught for one in chosen)} |"
        )
    others = [f"- seed {one.seed}, {one.kind}: {one.outcome}" for one in landings if one.outcome]
    return "\n".join([*lines, "", f"Flights that did not end as planned: {len(others)}.", *others])


def landings(words: Sequence[str]) -> Page:
    """Land many times and write the table."""
    chosen = options_of(__doc__, jobs=1, flights=200, first_seed=7000).parse_args(words)
    seeds = list(range(chosen.first_seed, chosen.first_seed + chosen.flights))
    landings = flown(land, seeds, jobs=chosen.jobs)
    before = "Real PX4, before contact by force: 63 landings, median 13, worst 146 degrees."
    note = f"Seeds {seeds[0]} to {seeds[-1]}. {before}"
    return Page("landings", "Landings on PX4's estimate", f"{note}\n\n{table(landings)}")
