"""Landings on PX4's estimate: tilt after contact, time until the motors stand still and the vehicle is disarmed.

Whole flights in lockstep on the mock's vehicle with PX4's estimator, whose height is wrong from the start and drifts
on, over ground of five kinds. Disarming is refused one to three times. Tilt is true, from the last contact on, and on
a slope what exceeds the slope. Beside it the tilt 0.5 s after the contact: in wind a vehicle touches down leaning.

    python -m benchmarks.landings [--flights 200] [--first-seed 7000] [--jobs 1]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, inf, radians

import msgspec
import numpy as np

from benchmarks.provenance import write_result
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import find_vehicle, parse_effect, read_vehicle
from flights.parallel import parallel_map
from runtime.control.controller import ControllerOptions
from runtime.flight.composition import Controllers, build_controllers
from runtime.flight.mission import Plan
from simulation.ground_to_ground import GroundToGround, after_contact
from sitl_mock.vehicle.estimator import ERRORS
from sitl_mock.vehicle.ground import Ground
from sitl_mock.vehicle.vehicle import VehicleOptions

VEHICLE, REFERENCE, PATIENCE = "px4_sih", "hover:laps=1,height=1.2", 90.0  # s
KINDS = ("flat", "windy", "sloped", "hard", "moving deck")
PLAN = Plan(height=1.2, duration=1.0, speed=2.5, acceleration=3.0, settle=0.3, origin="takeoff")
HARD = 0.8  # m/s
STANDING = 0.05  # of the weight, thrust below which the motors count as stopped
_controllers: list[Controllers] = []


@dataclass(frozen=True)
class Landing:
    """One landing. tilt, settled: degrees, from contact and from 0.5 s later. motors, disarmed: s from contact.

    caught: contacts that were none.
    """

    seed: int
    kind: str
    tilt: float
    settled: float
    motors: float
    disarmed: float
    caught: int
    outcome: str


def surroundings(kind: str, random: np.random.Generator) -> tuple[Ground, list[str]]:
    """Ground and air of a kind of landing."""
    direction, size = random.uniform(0, 2 * np.pi), random.uniform()
    match kind:
        case "windy":
            east, north = (1.0 + 4.0 * size) * np.array([np.cos(direction), np.sin(direction)])
            return Ground(kind="sih"), [f"wind:x={east:.2f},y={north:.2f}", f"gust:intensity={0.3 + 0.7 * size:.2f}"]
        case "sloped":
            return Ground(kind="legs", slope=radians(3.0 + 12.0 * size), uphill=direction), []
        case "hard":
            return Ground(kind="legs"), []
        case "moving deck":
            return Ground(kind="legs", heave=0.05 + 0.2 * size, heave_period=5.0), []
        case _:
            return Ground(kind="sih"), []


def land(seed: int) -> Landing:
    """Fly and land once."""
    vehicle = read_vehicle(find_vehicle(VEHICLE))
    if not _controllers:
        _controllers.append(build_controllers(vehicle, None, ControllerOptions.for_vehicle(vehicle, period=0.01)))
    random, kind = np.random.default_rng(seed), KINDS[seed % len(KINDS)]
    ground, texts = surroundings(kind, random)
    effects: Sequence[EffectUse] = [parse_effect(text, vehicle.rotors.count) for text in texts]
    sensors, wander = ERRORS["px4"]
    flight = GroundToGround(
        vehicle,
        _controllers[0],
        named_reference(REFERENCE, vehicle),
        msgspec.structs.replace(PLAN, touchdown=HARD) if kind == "hard" else PLAN,
        effects=effects,
        options=VehicleOptions(sensors=sensors, wander=wander, ground=ground),
        seed=seed,
        refusals=int(random.integers(1, 4)),
    ).fly(PATIENCE)
    contact, times, tilts = after_contact(flight)
    ticks = flight.ticks[-len(times) :]
    running = [tick.time for tick in ticks if tick.thrust > STANDING * vehicle.weight]
    armed = [tick.time for tick in ticks if tick.armed]
    landed = flight.outcome == "landed and disarmed" and not flight.landing_reason
    return Landing(
        seed,
        kind,
        degrees(max(0.0, float(tilts.max()) - ground.slope)),
        degrees(max(0.0, float(tilts[times > contact + 0.5].max(initial=0.0)) - ground.slope)),
        max(running, default=contact) - contact,
        max(armed, default=contact) - contact if landed else inf,
        len(flight.times("contact_lost")),
        "" if landed else flight.landing_reason or flight.outcome,
    )


def table(landings: Sequence[Landing]) -> str:
    """All kinds in Markdown."""
    lines = [
        "| ground | landings | tilt after contact, median, 95 %, worst, degrees | after 0.5 s, worst "
        "| thrust below 5 %, median, worst, s | disarmed, median, worst, s | contacts that were none |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for kind in ("all", *KINDS):
        chosen = [one for one in landings if kind in ("all", one.kind)]
        tilt = np.array([one.tilt for one in chosen])
        motors, disarmed = (np.array([getattr(one, name) for one in chosen]) for name in ("motors", "disarmed"))
        lines.append(
            f"| {kind} | {len(chosen)} | {np.median(tilt):.1f}, {np.quantile(tilt, 0.95):.1f}, {tilt.max():.1f} "
            f"| {max(one.settled for one in chosen):.1f} "
            f"| {np.median(motors):.2f}, {motors.max():.2f} | {np.median(disarmed):.1f}, {disarmed.max():.1f} "
            f"| {sum(one.caught for one in chosen)} |"
        )
    others = [f"- seed {one.seed}, {one.kind}: {one.outcome}" for one in landings if one.outcome]
    return "\n".join([*lines, "", f"Flights that did not end as planned: {len(others)}.", *others])


def main() -> None:
    """Land many times and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=7000)
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args()
    seeds = list(range(chosen.first_seed, chosen.first_seed + chosen.flights))
    landings = []
    for _, landing in parallel_map(land, seeds, jobs=chosen.jobs):
        landings.append(landing)
        print(landing, flush=True)
    before = "Real PX4, before contact by force: 63 landings, median 13, worst 146 degrees."
    note = f"Seeds {seeds[0]} to {seeds[-1]}. {before}"
    write_result("landings", "Landings on PX4's estimate", f"{note}\n\n{table(landings)}")


if __name__ == "__main__":
    main()
