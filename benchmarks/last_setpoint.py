"""Streams of setpoints that end at random ticks of random manoeuvres, with the check of the last setpoint and without.

In lockstep: 12 s of a manoeuvre of the catalogue in a random plane, size, speed and height, in a box that is 0.5 to
2.5 m larger than its path, by motion capture. At random ticks between take-off and touch-down the flight's process
forks, and in the fork nothing is sent any more: the mock holds the last setpoint for COM_OF_LOSS_T, 1 s, then its
failsafe lands (COM_OBL_RC_ACT 4). The flight itself goes on. A violation is a true position outside of the box, or a
first contact with the ground faster than 1.5 m/s or tilted by more than 32 degrees. Each manoeuvre is flown in each
mode. Metres are those from the place of death to the farthest place until the failsafe has braked.

    python -m benchmarks last_setpoint deaths [--flights 30] [--each 36]
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.measurement import Page, Result, measured, options_of, paragraph_of
from benchmarks.provenance import RESULTS
from dynamics.arrays import Floats
from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.references import MANOEUVRES, PAPER, Reference, named_reference
from dynamics.state import POSITION
from dynamics.vehicle import GRAVITY
from dynamics.vehicle_file import read_vehicle, write_vehicle
from runtime.control.controller import Controller
from runtime.control.rti.last_setpoint import Outcome
from runtime.flight.contact import uprightness
from runtime.flight.decision import FlyerSettings, LastSetpointMode
from runtime.flight.events import Event
from runtime.flight.health import HealthLimits
from runtime.flight.last_setpoint import TOUCH_SPEED, TOUCH_UPRIGHT, failing_share, last_setpoint_model
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from simulation.whole_flight import CARRIED, Lockstep, WholeFlight, fly_whole
from sitl_mock.autopilot.modes import Mode
from sitl_mock.mock import MockOptions
from vehicles import FOLDER

VEHICLES: Mapping[str, tuple[float, float]] = {"arpl_250g": (0.5, 1.1), "px4_sih": (0.4, 0.7)}  # speed, from and to
MODES: tuple[LastSetpointMode, ...] = ("off", "auto", "replace")
ALOFT = (Phase.CLIMB, Phase.APPROACH, Phase.TRACK, Phase.BRAKE, Phase.RETURN, Phase.DESCEND)
FIRST_SEED, DURATION, LIMIT = 71_000, 12.0, 90.0
WATCHED = 12.0  # s after a death, at most
BRAKED = 0.3  # m/s
PICTURE = "last_setpoint.png"
TICKS = 2200  # aloft, of a flight
LOSS_TIMES, HEIGHTS, PLANNED = (1.0, 0.5, 0.3), (1.0, 3.0, 8.0), (*PAPER, "hover", "circle", "line")


def drawn(number: int) -> dict[str, Any]:
    """A manoeuvre by its number."""
    random = np.random.default_rng((FIRST_SEED, number))
    vehicle = str(random.choice(list(VEHICLES)))
    shape = {
        "plane": str(random.choice(["xy", "xz", "yz", "x-y", "z-x"])),
        "speed": random.uniform(*VEHICLES[vehicle]),
        "size": random.uniform(0.7, 1.3),
        "height": random.uniform(1.0, 5.0),
    }
    words = ",".join(f"{key}={value if isinstance(value, str) else f'{value:.2f}'}" for key, value in shape.items())
    return {
        "number": number,
        "vehicle": vehicle,
        "reference": f"{random.choice(list(MANOEUVRES))}:{words}",
        "margins": random.uniform(0.5, 2.5, size=6).tolist(),
    }


def box_around(reference: Reference, margins: Sequence[float]) -> tuple[Floats, Floats]:
    """Corners of a box about the path and the place of take-off, m."""
    path = np.vstack([reference.states(np.linspace(0, DURATION, 300))[:, POSITION], [[0.0, 0.0, 1.5], [0.0, 0.0, 0.0]]])
    return path.min(axis=0) - margins[:3], path.max(axis=0) + margins[3:]


class Deaths:
    """Ends the stream of setpoints in forks of a flight. results: of each."""

    def __init__(self, box: tuple[Floats, Floats], seed: int, count: int, expected_ticks: int) -> None:
        self.results: list[dict[str, Any]] = []
        self._box, self._random, self._left, self._share = (
            box,
            np.random.default_rng(seed),
            count,
            count / expected_ticks,
        )

    def watch(self, flight: Lockstep) -> None:
        """Fork before a tick now and then."""
        if flight.flyer.mission.phase not in ALOFT or not self._left or self._random.random() > self._share:
            return
        self._left -= 1
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                os.write(writing, json.dumps(self._die(flight)).encode())
            finally:
                os._exit(0)
        os.close(writing)
        with os.fdopen(reading) as answer:
            text = answer.read()
        os.waitpid(child, 0)
        self.results.append(json.loads(text))

    def _die(self, flight: Lockstep) -> dict[str, Any]:
        """What happens when nothing is sent any more."""
        autopilot, vehicle, (low, high) = flight.autopilot, flight.vehicle, self._box
        start, place, sent = autopilot.time, vehicle.truth.position_world.copy(), autopilot.commander.offboard.count
        outside, farthest, impact, tilt, contact = 0.0, 0.0, 0.0, 1.0, False
        while autopilot.time - start < WATCHED:
            before = vehicle.truth
            autopilot.step()
            truth = vehicle.truth
            outside = max(outside, float(np.max(np.maximum(low - truth.position_world, truth.position_world - high))))
            farthest = max(farthest, float(np.linalg.norm(truth.position_world - place)))
            tilt = min(tilt, uprightness(truth.attitude))
            sideways, sinking = float(np.hypot(*truth.velocity_world[:2])), -float(truth.velocity_world[2])
            if vehicle.ground_force > CARRIED:
                contact, speed = True, -float(before.velocity_world[2])
                impact = speed if speed > TOUCH_SPEED or uprightness(truth.attitude) < TOUCH_UPRIGHT else 0.0
                break
            failsafe = autopilot.commander.mode is not Mode.OFFBOARD
            if failsafe and sideways < BRAKED and abs(sinking - 0.7) < BRAKED and uprightness(truth.attitude) > 0.97:
                break
        return {
            "phase": flight.flyer.mission.phase.value,
            "outside": outside,
            "metres": farthest,
            "impact": impact,
            "contact": contact,
            "tilt": float(np.degrees(np.arccos(tilt))),
            "sent": autopilot.commander.offboard.count - sent,
            "seconds": autopilot.time - start,
        }


def flown(case: Mapping[str, Any]) -> dict[str, Any]:
    """One flight in one mode, with its deaths."""
    source = FOLDER / f"{case['vehicle']}.toml"
    reference = named_reference(case["reference"], read_vehicle(source))
    box = box_around(reference, case["margins"])
    corners = tuple(tuple(round(float(value), 3) for value in corner) for corner in box)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "vehicle.toml"
        plain = read_vehicle(source)
        vehicle = msgspec.structs.replace(plain, limits=msgspec.structs.replace(plain.limits, box=corners))
        write_vehicle(vehicle, file)
        settings = FlyerSettings(
            period=CONTROL_PERIOD, health=HealthLimits.for_vehicle(vehicle), last_setpoint=case["mode"]
        )
        deaths = Deaths(box, case["number"], case["deaths"], case["ticks"])
        replaced = Replaced()

        def watch(flight: Lockstep) -> None:
            replaced.watch(flight)
            deaths.watch(flight)

        flight = fly_whole(
            MockOptions(file, seed=case["number"], estimator="mocap", ground="legs", clock="steady",
                        parameters={"COM_OBL_RC_ACT": 4.0}),
            reference,
            plan=Plan(origin="takeoff", height=1.5, duration=DURATION),
            settings=settings,
            watch=watch,
            limit=LIMIT,
        )  # fmt: skip
    return {**case, "deaths": deaths.results, **_of_flight(flight), "replaced": replaced.share, "none": replaced.none}


class Replaced:
    """Share of ticks aloft whose setpoint was replaced."""

    def __init__(self) -> None:
        self.ticks = self.count = self.none = 0

    def watch(self, flight: Lockstep) -> None:
        """Count the last tick."""
        if flight.flyer.mission.phase in ALOFT:
            findings = flight.flyer.last_setpoint.findings
            self.ticks += 1
            self.count += bool(findings)
            self.none += Event.LAST_SETPOINT_UNSAFE in findings

    @property
    def share(self) -> float:
        """Of all ticks."""
        return self.count / max(self.ticks, 1)


def _of_flight(flight: WholeFlight) -> dict[str, Any]:
    return {
        "rmse": flight.tracking_error(flight.truth),
        "landed": flight.landed,
        "ended": flight.landing_reason or ("" if flight.landed else flight.outcome),
        "unchecked": Event.LAST_SETPOINT_UNCHECKED in flight.raised,
    }


def key_of(case: Mapping[str, Any]) -> str:
    """Key of a case."""
    return f"{case['number']} {case['mode']}"


def fly(case: Mapping[str, Any]) -> dict[str, Any]:
    """A case and its key."""
    return {"key": key_of(case), **flown(case)}


def deaths(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__, jobs=2, resumes="last_setpoint", flights=30, each=36)
    chosen = parser.parse_args(words)
    cases = [
        {**drawn(number), "mode": mode, "deaths": chosen.each, "ticks": TICKS}
        for number in range(chosen.flights)
        for mode in MODES
    ]
    results = measured(fly, cases, chosen, _line, key_of=key_of)
    by_mode = {mode: [r for r in results if r["mode"] == mode] for mode in MODES}
    written = not (chosen.no_page or chosen.quick)
    if written:
        draw({mode: metres_of(flights) for mode, flights in by_mode.items()}, RESULTS / PICTURE)
    parts = [
        paragraph_of(__doc__),
        _death_table(by_mode),
        f"![metres]({PICTURE})" if written else "",
        "## What it costs the flights",
        _flight_table(by_mode),
        "## Which flights are planned so that every setpoint passes",
        "Share of a reference's setpoints that fail, as `auto` looks at them, with nothing but the ground below the "
        "manoeuvre of the paper, on arpl_250g: by COM_OF_LOSS_T and by the height of the lowest point.",
        _planned_table(PLANNED if not chosen.quick else PLANNED[:1]),
        "## Time of a check",
        _time_table(200 if chosen.quick else 20_000),
    ]
    return Page("last_setpoint", "A setpoint that may be the last one", "\n\n".join(filter(None, parts)))


def _line(result: Result) -> str:
    failed = sum(map(violates, result["deaths"]))
    return f"{result['key']:12} {result['reference']}: {failed} of {len(result['deaths'])}, {result['rmse']:.3f} m"


def violates(death: Mapping[str, Any]) -> bool:
    """Whether a death ends outside of the box or in a crash."""
    return bool(death["outside"] > 0.0 or death["impact"] > 0.0)


def deaths_of(flights: Sequence[Result]) -> list[Mapping[str, Any]]:
    """All deaths of flights."""
    return [death for flight in flights for death in flight["deaths"]]


def metres_of(flights: Sequence[Result]) -> list[float]:
    """Metres travelled after each death."""
    return [death["metres"] for death in deaths_of(flights)]


def _death_table(by_mode: Mapping[str, Sequence[Result]]) -> str:
    head = ("mode", "deaths", "violations", "outside of the box", "crashes", "setpoints after death",
            "metres, median", "90 %", "99 %", "most")  # fmt: skip
    rows = [" | ".join(head), " | ".join("---" for _ in head)]
    checked = [flight for flight in by_mode["auto"] if not flight["unchecked"]]
    numbers = {flight["number"] for flight in checked}
    same = [flight for flight in by_mode["off"] if flight["number"] in numbers]
    groups = {**by_mode, "auto, flights that it checks": checked, "off, the same flights": same}
    for name, flights in groups.items():
        each, metres = deaths_of(flights), metres_of(flights) or [float("nan")]
        counts = (
            len(each), sum(map(violates, each)), *(sum(d[kind] > 0 for d in each) for kind in ("outside", "impact")),
            sum(d["sent"] for d in each),
        )  # fmt: skip
        spread = [f"{value:.2f}" for value in (*np.percentile(metres, [50, 90, 99]), max(metres))]
        rows.append(" | ".join([name, *map(str, counts), *spread]))
    return "\n".join(f"| {row} |" for row in rows)


def _flight_table(by_mode: Mapping[str, Sequence[Result]]) -> str:
    off = {flight["number"]: flight for flight in by_mode["off"]}
    head = ("planned so that", "mode", "flights", "tracking error, median, m", "over that without, median", "most",
            "setpoints replaced", "ticks without one that passes", "cut short")  # fmt: skip
    rows = [" | ".join(head), " | ".join("---" for _ in head)]
    easy = {flight["number"] for flight in by_mode["auto"] if not flight["unchecked"]}
    for name, members in (("every setpoint passes", easy), ("some fail", set(off) - easy)):
        for mode, flights in by_mode.items():
            chosen = [flight for flight in flights if flight["number"] in members]
            if not chosen:
                continue
            ratios = [f["rmse"] / off[f["number"]]["rmse"] for f in chosen]
            replaced, error = np.mean([f["replaced"] for f in chosen]), np.nanmedian([f["rmse"] for f in chosen])
            rows.append(
                f"{name} | {mode} | {len(chosen)} | {error:.4f} | {np.nanmedian(ratios):.2f} | {np.nanmax(ratios):.2f} "
                f"| {replaced:.1%} | {sum(f['none'] for f in chosen)} | {sum(bool(f['ended']) for f in chosen)}"
            )
    return "\n".join(f"| {row} |" for row in rows)


def _planned_table(names: Sequence[str]) -> str:
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    controller = Controller.build(vehicle)
    rows = ["manoeuvre | " + " | ".join(f"{t:g} s, {h:g} m" for t in LOSS_TIMES for h in HEIGHTS),
            " | ".join("---" for _ in range(1 + len(LOSS_TIMES) * len(HEIGHTS)))]  # fmt: skip
    for name in names:
        cells = []
        for loss_time in LOSS_TIMES:
            check = controller.solver.last_setpoint_check(last_setpoint_model(controller, None, loss_time))
            for height in HEIGHTS:
                reference = named_reference(f"{name}:height={height:g}", vehicle)
                check.model.ground = 0.0
                share = failing_share(check, reference, reference.duration, vehicle.rotors.thrust_constant)
                cells.append(f"{share:.0%}")
        rows.append(" | ".join([name, *cells]))
    return "\n".join(f"| {row} |" for row in rows)


def _time_table(count: int) -> str:
    """Times of checks in this process, by their outcome, us, with the call from Python."""
    controller = Controller.build(read_vehicle(FOLDER / "arpl_250g.toml"))
    model = last_setpoint_model(controller, None, 1.0)
    model.low[:], model.high[:], model.ground = [-6.0, -6.0, -1.0], [6.0, 6.0, 8.0], 0.0
    check, random, hover = controller.solver.last_setpoint_check(model), np.random.default_rng(0), model.mass * GRAVITY
    times: dict[Outcome, list[float]] = {outcome: [] for outcome in Outcome}
    for _ in range(count):
        state = np.concatenate([random.uniform(-4, 4, 2), random.uniform(0.5, 6, 1), random.uniform(-2, 2, 3),
                                [1.0, *random.uniform(-0.2, 0.2, 2), 0.0], random.uniform(-2, 2, 3)])  # fmt: skip
        state[6:10] /= np.linalg.norm(state[6:10])
        rates, thrust = random.uniform(-1, 1, 3) * random.choice([0.3, 3.0]), hover * random.uniform(0.7, 1.4)
        best = np.inf
        for _ in range(3):  # of three, as other programs take the processor
            start = time.perf_counter_ns()
            outcome = check.check(state, 0.02, hover, rates, thrust).outcome
            best = min(best, 1e-3 * (time.perf_counter_ns() - start))
        times[outcome].append(best)
    rows = ["outcome | checks | median, us | 99 % | most", "--- | --- | --- | --- | ---"]
    for outcome, values in times.items():
        if values:
            p50, p99 = np.percentile(values, [50, 99])
            name = outcome.name.lower().replace("_", " ")
            rows.append(f"{name} | {len(values)} | {p50:.1f} | {p99:.1f} | {max(values):.1f}")
    return "\n".join(f"| {row} |" for row in rows)


def draw(metres: Mapping[str, Sequence[float]], path: Path) -> None:
    """Histogram of the metres travelled after death, one row a mode."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), layout="constrained")
    edges = np.linspace(0.0, max(map(max, metres.values())), 45)
    rows = figure.subplots(len(metres), 1, sharex=True, sharey=True)
    for axes, (mode, values) in zip(rows, metres.items(), strict=True):
        axes.hist(values, edges, color="tab:blue")
        axes.set_title(
            f"{mode}: median {np.median(values):.2f} m, at most {max(values):.1f} m", loc="left", fontsize=10
        )
        axes.set_yscale("log")
        axes.set_ylabel("deaths")
    rows[-1].set_xlabel("metres from the place of death to the farthest place until the failsafe has braked")
    figure.savefig(path, dpi=110)
