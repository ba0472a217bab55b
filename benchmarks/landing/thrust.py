"""Take-offs and losses of thrust on PX4's estimate: whether motors are stopped in the air, and how flights then end.

Whole flights in lockstep on px4_sih with the mock's estimator of PX4, which drifts at rest by what it integrates of the
accelerometer's noise. Take-offs: thrust is 0.6 to 1.6 of the vehicle file's, ground flat or sloped. Losses: in a hover,
circle or Lemniscate at 1.5 to 6 m, or on the way down, thrust falls to 20 to 90 % of what it was, at once or within
seconds; below half of it this vehicle cannot hold its weight.

Stopped in the air: less than 15 % of the hover thrust was sent, or the motors were disarmed, with the feet more than
0.3 m above the ground. A crash: the ground met at 2 m/s or more. Contact to motors off counts from the last contact.

    python -m benchmarks landing thrust [--flights 1000] [--first-seed 50000] [--jobs 1]

A finished flight is a line of build/thrust_in_the_air.jsonl: a run that was stopped resumes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, log, nan, pi, radians
from typing import Literal

import msgspec
import numpy as np

from benchmarks.landing.whole_flights import with_controllers
from benchmarks.measurement import Page, Result, measured, options_of
from dynamics.references import named_reference
from dynamics.state import RATE, VELOCITY
from dynamics.vehicle_file import find_vehicle
from runtime.flight.events import Event
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from simulation.whole_flight import CARRIED, Lockstep, WholeFlight, fly_whole
from sitl_mock.mock import MockOptions
from sitl_mock.scenario import Scenario
from sitl_mock.vehicle.ground import Ground

Kind = Literal["take-off", "loss"]
VEHICLE, PATIENCE = "px4_sih", 90.0  # s
RATIO = "thrust_constant.ratio"
HIGH, STOPPED = 0.3, 0.15  # m above the ground, and share of the hover thrust that counts as none
CRASH = 2.0  # m/s at which the ground is met
HOLDS = 1.15  # thrust per weight with which a vehicle can still descend as it wants to
PLAN = Plan(height=1.2, duration=1.0, speed=2.5, acceleration=3.0, settle=0.3, origin="takeoff")
SECONDS, ALOFT = 8.0, 3.0  # s of a reference, and s after lift-off before which no thrust is lost


@dataclass(frozen=True)
class Case:
    """One flight of the study.

    thrust: true per modelled, at the start.
    share: of it that a loss leaves, within `fade` s, `after` s in the air.
    """

    seed: int
    kind: Kind
    what: str
    thrust: float
    share: float = 1.0
    fade: float = 0.0
    after: float = inf
    reference: str = "hover:laps=1,height=1.2"
    plan: Plan = PLAN
    ground: Ground = Ground(kind="sih")  # noqa: RUF009 - a frozen struct


@dataclass(frozen=True)
class Flown:
    """Outcome of a case.

    lifted: clearance at which the ramp counted as lifted, m; negative while the ground still carried the vehicle.
    estimated: estimated over true thrust, at lift-off.
    stopped: greatest clearance without thrust after lift-off, m; 0 if it was never off in the air.
    sink: m/s at the first contact after the flight; nan without one.
    off: s from the last contact to no thrust. rate: rad/s of tilting then.
    tilt: degrees beyond the slope, from the last contact on.
    capable: thrust per weight at the end.
    """

    case: Case
    lifted: float
    estimated: float
    stopped: float
    sink: float
    off: float
    rate: float
    tilt: float
    capable: float
    landed: bool
    outcome: str
    events: tuple[str, ...]

    @property
    def false_landing(self) -> bool:
        """Whether a crash was called a landing."""
        return self.sink > CRASH and self.outcome.startswith("landed")


def case_of(seed: int) -> Case:
    """The case of a seed: take-offs and losses in turn."""
    random = np.random.default_rng(seed)
    direction, size = float(random.uniform(0, 2 * pi)), float(random.uniform())
    if seed % 2 == 0:
        sloped = random.uniform() < 0.3
        ground = Ground(kind="legs", slope=radians(12.0 * size), uphill=direction) if sloped else Ground(kind="sih")
        thrust = exp(random.uniform(log(0.6), log(1.6)))
        return Case(seed, "take-off", "slope" if sloped else "flat", thrust, ground=ground)
    height, share = float(random.uniform(1.5, 6.0)), float(random.uniform(0.2, 0.9))
    name = str(random.choice(["hover", "circle", "Lemniscate"]))
    fade = 0.0 if random.uniform() < 0.5 else float(random.uniform(0.3, 5.0))
    plan = Plan(height=height, duration=SECONDS, speed=2.5, acceleration=3.0, settle=0.3, origin="takeoff")
    after = ALOFT + float(random.uniform(0.0, SECONDS + 4.0))
    speed = "laps=1" if name == "hover" else f"speed={random.uniform(1.0, 2.0):.2f}"
    thrust = float(random.uniform(0.85, 1.2))
    reference = f"{name}:{speed},height={height:.2f}"
    return Case(seed, "loss", name, thrust, share, fade, after, reference, plan, Ground(kind="sih"))


class ThrustLoss:
    """Lets thrust fade in flight, and notes what the flight logic takes for lift-off."""

    def __init__(self, case: Case) -> None:
        self._case, self._since, self._present = case, inf, 1.0
        self.lifted, self.estimated = nan, nan

    def __call__(self, lockstep: Lockstep) -> None:
        """Called before each tick."""
        flyer, vehicle, case = lockstep.flyer, lockstep.vehicle, self._case
        if self._since == inf and flyer.mission.phase is Phase.CLIMB:
            self._since = vehicle.time
            carried = vehicle.ground_force > CARRIED
            self.lifted = -vehicle.ground_force if carried else vehicle.clearance
            self.estimated = flyer.effectiveness.value / case.thrust
        elapsed = vehicle.time - self._since - case.after
        if elapsed < 0.0 or self._present == case.share or elapsed == -inf:
            return
        faded = min(elapsed / case.fade, 1.0) if case.fade else 1.0
        self._present = 1.0 + faded * (case.share - 1.0)
        vehicle.change({RATIO: case.thrust * self._present})


def fly(seed: int) -> Flown:
    """Fly one case."""
    case = case_of(seed)
    vehicle, controllers = with_controllers(VEHICLE)
    loss = ThrustLoss(case)
    options = MockOptions(
        find_vehicle(VEHICLE),
        effects=(f"thrust_constant:ratio={case.thrust:.4f}",),
        scenario=Scenario(ground=case.ground),
        seed=seed,
    )
    reference = named_reference(case.reference, vehicle, duration=SECONDS)
    flight = fly_whole(options, reference, plan=case.plan, controllers=controllers, watch=loss, limit=PATIENCE)
    capable = vehicle.rotors.thrust_max / vehicle.weight * case.thrust * case.share
    return outcome_of(case, flight, loss, hover=vehicle.weight, capable=capable)


def outcome_of(case: Case, flight: WholeFlight, loss: ThrustLoss, *, hover: float, capable: float) -> Flown:
    """The figures of a flight. hover: N."""
    time, thrust, height = (np.array(column) for column in (flight.time, flight.thrust, flight.clearance))
    truth, carried, armed = np.array(flight.truth), np.array(flight.ground_force), np.array(flight.armed)
    none = (thrust < STOPPED * hover) | ~armed
    flown = np.maximum.accumulate(height > 0.1)
    sink = off = rate = tilt = nan
    after = np.flatnonzero(flown)
    by_us = none & (np.array(flight.setpoints_sent) | ~armed)  # an autopilot that was left the vehicle flies it itself
    stopped = float(height[flown & by_us].max(initial=0.0))
    touched = after[carried[after] > CARRIED]
    if touched.size:
        sink = float(max(-truth[touched[0] - 3 : touched[0] + 1, VELOCITY.start + 2]))
        contact = min(flight.contact, len(time) - 1)
        running = np.flatnonzero(~none[contact:])
        end = contact + (int(running[-1]) if running.size else 0)
        off = float(time[end] - time[contact])
        rate = float(np.linalg.norm(truth[end, RATE][:2]))
        tilt = float(np.degrees(max(0.0, flight.tilt[contact:].max() - case.ground.slope)))
    events = tuple(event.value for _, event, _ in flight.events if event is not Event.ESTIMATE_JUMP)
    estimated = (loss.lifted, loss.estimated, stopped if stopped > HIGH else 0.0)
    return Flown(case, *estimated, sink, off, rate, tilt, capable, flight.landed, flight.outcome, events)


def quantiles(values: Sequence[float]) -> str:
    """Median, 95 % and greatest."""
    finite = np.array([value for value in values if np.isfinite(value)])
    return ", ".join(f"{value:.2f}" for value in np.quantile(finite, [0.5, 0.95, 1.0])) if finite.size else "-"


def row(name: str, flights: Sequence[Flown]) -> str:
    """One row of the table."""
    soft = [one for one in flights if not one.sink > CRASH]
    return (
        f"| {name} | {len(flights)} | {sum(one.stopped > 0 for one in flights)} "
        f"| {sum(one.lifted < 0 for one in flights)} | {quantiles([one.sink for one in flights])} "
        f"| {sum(one.sink > CRASH for one in flights)} | {sum(one.false_landing for one in flights)} "
        f"| {quantiles([one.off for one in soft])} | {quantiles([one.rate for one in soft])} "
        f"| {quantiles([one.tilt for one in soft])} |"
    )


def table(flights: Sequence[Flown]) -> str:
    """All kinds in Markdown, and the flights that one would look at."""
    able = [one for one in flights if one.case.kind == "loss" and one.capable >= HOLDS]
    unable = [one for one in flights if one.case.kind == "loss" and one.capable < HOLDS]
    take_offs = [one for one in flights if one.case.kind == "take-off"]
    lines = [
        "| flights | count | motors stopped in the air | lift-offs that were none "
        "| sink at contact, median, 95 %, worst, m/s "
        "| crashes | of them called a landing | contact to motors off, s | rate of tilt then, rad/s "
        "| tilt after contact, degrees |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        row("take-offs", take_offs),
        *(row(f"take-offs, {what}", [one for one in take_offs if one.case.what == what]) for what in ("flat", "slope")),
        row(f"losses that leave {HOLDS} of the weight or more", able),
        row("losses that leave less", unable),
    ]
    estimated = [abs(log(one.estimated)) for one in flights if one.estimated > 0]
    lifted = quantiles([one.lifted for one in flights if one.lifted >= 0])
    never = [one for one in flights if np.isnan(one.lifted)]
    shown = [one for one in flights if one.stopped or one.lifted < 0 or one.false_landing or np.isnan(one.lifted)]
    return "\n".join(
        [
            *lines,
            "",
            f"Times, rates and tilts are those of flights that did not crash, median, 95 %, worst. At lift-off: "
            f"clearance {lifted} m, "
            f"effectiveness off by {100 * np.median(estimated):.0f} % (median), {100 * max(estimated):.0f} % "
            f"(worst). Not taken off: {len(never)}.",
            "",
            *(
                f"- seed {one.case.seed}, {one.case.what}, thrust {one.case.thrust:.2f}, to {one.case.share:.2f} in "
                f"{one.case.fade:.1f} s: lifted at {one.lifted:.2f}, stopped at {one.stopped:.2f} m, "
                f"sink {one.sink:.1f} m/s, {one.outcome}"
                for one in shown
            ),
        ]
    )


def result_of(seed: int) -> Result:
    """The outcome of a seed as it is kept."""
    return {"key": seed, "flown": msgspec.to_builtins(fly(seed))}


def line_of(result: Result) -> str:
    """One line about a finished flight."""
    one = msgspec.convert(result["flown"], Flown)
    return f"{one.case.seed} {one.case.kind}: stopped at {one.stopped:.2f} m, sink {one.sink:.1f} m/s, {one.outcome}"


def thrust(words: Sequence[str]) -> Page:
    """Fly what has not been flown. Returns the page."""
    chosen = options_of(__doc__, resumes="thrust_in_the_air", jobs=1, flights=1000, first_seed=50000).parse_args(words)
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.flights)
    results = measured(result_of, seeds, chosen, line_of, key_of=int)
    flights = [msgspec.convert(result["flown"], Flown) for result in results]
    note = f"Seeds {seeds[0]} to {seeds[-1]}, of which the even ones are take-offs."
    return Page("thrust_in_the_air", "Take-offs and losses of thrust", f"{note}\n\n{table(flights)}")
