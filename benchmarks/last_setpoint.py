"""Streams of setpoints that end at random ticks of random manoeuvres, with the check of the last setpoint and without.

In lockstep: 12 s of a manoeuvre of the catalogue in a random plane, size, speed and height, in a box that is 0.5 to
2.5 m larger than its path, by motion capture. At random ticks between take-off and touch-down the flight's process
forks, and in the fork nothing is sent any more: the mock holds the last setpoint for COM_OF_LOSS_T, 1 s, then its
failsafe lands (COM_OBL_RC_ACT 4). The flight itself goes on. A violation is a true position outside of the box, or a
first contact with the ground faster than 1.5 m/s or tilted by more than 32 degrees. Each manoeuvre is flown in each
mode; `auto` dies as `off` where it leaves the flight alone, and as `replace` where it checks it. Metres are those from
the place of death to the farthest place until the failsafe has braked.

    python -m benchmarks last_setpoint deaths [--flights 30] [--each 36]
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.link.daemon import ALULA
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
from runtime.flight.last_setpoint import LAND_SPEED, TOUCH_SPEED, TOUCH_UPRIGHT, last_setpoint_model
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from runtime.flight.plan_review import failing_share
from simulation.mock_process import free_port
from simulation.whole_flight import CARRIED, Lockstep, WholeFlight, fly_whole
from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.modes import Mode
from sitl_mock.mock import MockOptions, build_autopilot
from sitl_mock.server import Server, Wire
from sitl_mock.vehicle.vehicle import SimulatedVehicle
from sitl_mock.wire.link_spec import parse_link
from vehicles import FOLDER

VEHICLES: Mapping[str, tuple[float, float]] = {"arpl_250g": (0.5, 1.1), "px4_sih": (0.4, 0.7)}  # speed, from and to
MODES: tuple[LastSetpointMode, ...] = ("off", "auto", "replace")
ALOFT = (Phase.CLIMB, Phase.APPROACH, Phase.TRACK, Phase.BRAKE, Phase.RETURN, Phase.DESCEND)
FIRST_SEED, DURATION, LIMIT = 71_000, 12.0, 90.0
WATCHED = 12.0  # s after a death, at most
BRAKED = 0.3  # m/s
ALOFT_HEIGHT = 0.5  # m
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
        """The rest of the flight when nothing is sent any more."""
        fall = Fall(flight.autopilot, self._box)
        while not fall.over:
            flight.autopilot.step()
            fall.look()
        return {"phase": flight.flyer.mission.phase.value, **fall.result}


class Fall:
    """A vehicle whose stream of setpoints has ended, until the failsafe has braked it or it touches the ground.

    over: whether that has come.
    """

    def __init__(self, autopilot: Autopilot, box: tuple[Floats, Floats]) -> None:
        assert isinstance(autopilot.vehicle, SimulatedVehicle)
        self.over = False
        self._autopilot, self._vehicle, self._box = autopilot, autopilot.vehicle, box
        self._start, self._sent = autopilot.time, autopilot.commander.offboard.count
        self._place, self._sinking = self._vehicle.truth.position_world.copy(), 0.0
        self._outside, self._distance, self._impact, self._upright = 0.0, 0.0, 0.0, 1.0

    def look(self) -> None:
        """Look at the vehicle after a step of the autopilot."""
        truth, (low, high) = self._vehicle.truth, self._box
        position, upright = truth.position_world, uprightness(truth.attitude)
        self._outside = max(self._outside, float(np.max(np.maximum(low - position, position - high))))
        self._distance = max(self._distance, float(np.linalg.norm(position - self._place)))
        self._upright = min(self._upright, upright)
        sideways, before = float(np.hypot(*truth.velocity_world[:2])), self._sinking
        self._sinking = -float(truth.velocity_world[2])
        contact = self._vehicle.ground_force > CARRIED
        if contact and (before > TOUCH_SPEED or upright < TOUCH_UPRIGHT):
            self._impact = max(before, 1e-3)
        failsafe = self._autopilot.commander.mode is not Mode.OFFBOARD
        braked = failsafe and sideways < BRAKED and abs(self._sinking - LAND_SPEED) < BRAKED and upright > 0.97
        self.over = contact or braked or self._autopilot.time - self._start > WATCHED

    @property
    def result(self) -> dict[str, Any]:
        """Metres outside and travelled, m/s of an impact, greatest tilt in degrees, setpoints that came."""
        return {
            "outside": self._outside,
            "metres": self._distance,
            "impact": self._impact,
            "tilt": float(np.degrees(np.arccos(self._upright))),
            "sent": self._autopilot.commander.offboard.count - self._sent,
            "seconds": self._autopilot.time - self._start,
        }


def vehicle_in_box(case: Mapping[str, Any], reference: Reference, folder: Path) -> Path:
    """The file of a case's vehicle with its box."""
    plain, file = read_vehicle(FOLDER / f"{case['vehicle']}.toml"), folder / "vehicle.toml"
    corners = tuple(tuple(float(round(v, 3)) for v in corner) for corner in box_around(reference, case["margins"]))
    write_vehicle(msgspec.structs.replace(plain, limits=msgspec.structs.replace(plain.limits, box=corners)), file)
    return file


def options_of_mock(case: Mapping[str, Any], file: Path) -> MockOptions:
    """The mock of a case: by motion capture, its failsafe lands."""
    parameters = {"COM_OBL_RC_ACT": 4.0}
    return MockOptions(
        file, seed=case["number"], estimator="mocap", ground="legs", clock="steady", parameters=parameters
    )


def flown(case: Mapping[str, Any]) -> dict[str, Any]:
    """One flight in one mode, with its deaths."""
    reference = named_reference(case["reference"], read_vehicle(FOLDER / f"{case['vehicle']}.toml"))
    with tempfile.TemporaryDirectory() as folder:
        file = vehicle_in_box(case, reference, Path(folder))
        health = HealthLimits.for_vehicle(read_vehicle(file))
        settings = FlyerSettings(period=CONTROL_PERIOD, health=health, last_setpoint=case["mode"])
        deaths = Deaths(box_around(reference, case["margins"]), case["number"], case["deaths"], case["ticks"])
        replaced = Replaced()

        def watch(flight: Lockstep) -> None:
            replaced.watch(flight)
            deaths.watch(flight)

        plan = Plan(origin="takeoff", height=1.5, duration=DURATION)
        options = options_of_mock(case, file)
        flight = fly_whole(options, reference, plan=plan, settings=settings, watch=watch, limit=LIMIT)
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
        {**drawn(number), "mode": mode, "deaths": 0 if mode == "auto" else chosen.each, "ticks": TICKS}
        for number in range(chosen.flights)
        for mode in MODES
    ]
    results = measured(fly, cases, chosen, _line, key_of=key_of)
    by_mode = {mode: [r for r in results if r["mode"] == mode] for mode in MODES}
    by_mode["auto"] = [_with_deaths(flight, by_mode) for flight in by_mode["auto"]]
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


def _with_deaths(flight: Result, by_mode: Mapping[str, Sequence[Result]]) -> Result:
    """A flight of `auto` with the deaths of the mode that it is flown in."""
    flown_as = by_mode["off" if flight["unchecked"] else "replace"]
    return {**flight, "deaths": next(other["deaths"] for other in flown_as if other["number"] == flight["number"])}


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


def kills(words: Sequence[str]) -> Page:
    """True `kill -9` of `alula fly` in the air, beside the mock in this process, in real time.

    A manoeuvre of the measurement in lockstep with its box, killed 1 to 14 s after it has left the ground. Setpoints
    after death are those that arrive later than the pass of the mock after the process has gone.

        python -m benchmarks last_setpoint kills [--kills 12]
    """
    parser = options_of(kills.__doc__, resumes="last_setpoint_kills", kills=12)
    parser.set_defaults(jobs=1)
    chosen = parser.parse_args(words)
    cases = [{**drawn(number), "mode": mode} for number in range(chosen.kills) for mode in ("off", "replace")]
    results = measured(killed, cases, chosen, lambda r: f"{r['key']}: {r['death']}", key_of=key_of)
    head = ("mode", "kills in the air", "violations", "setpoints after death", "metres, median", "most")
    rows = [" | ".join(head), " | ".join("---" for _ in head)]
    for mode in ("off", "replace"):
        each = [result["death"] for result in results if result["mode"] == mode and result["death"]]
        metres = [death["metres"] for death in each] or [float("nan")]
        counts = len(each), sum(map(violates, each)), sum(death["sent"] for death in each)
        rows.append(" | ".join([mode, *map(str, counts), f"{np.median(metres):.2f}", f"{max(metres):.2f}"]))
    away = [result["key"] for result in results if not result["death"]]
    parts = [paragraph_of(kills.__doc__), "\n".join(f"| {row} |" for row in rows)]
    if away:
        parts.append(f"Not in the air when it was to be killed: {', '.join(away)}.")
    return Page("last_setpoint_kills", "kill -9 of the daemon in flight", "\n\n".join(parts))


def killed(case: Mapping[str, Any]) -> dict[str, Any]:
    """A case and the death of its daemon, empty where it was not in the air."""
    reference = named_reference(case["reference"], read_vehicle(FOLDER / f"{case['vehicle']}.toml"))
    with tempfile.TemporaryDirectory() as folder:
        file = vehicle_in_box(case, reference, Path(folder))
        port = free_port()
        autopilot = build_autopilot(options_of_mock(case, file))
        specs = [parse_link(f"udpout:127.0.0.1:{port}", "onboard")]
        wires = [Wire(autopilot.add_link(spec.name, spec.role), spec.open()) for spec in specs]
        command = [*ALULA, "fly", "--link", f"udpin:127.0.0.1:{port}", "--vehicle", str(file), "--reference",
                   case["reference"], "--last-setpoint", case["mode"]]  # fmt: skip
        steady = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK  # a mock that starves would end the flight
        with suppress(PermissionError):
            os.sched_setscheduler(0, steady, os.sched_param(1))
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as daemon:
            watch = Killing(autopilot, daemon, box_around(reference, case["margins"]), case["number"])
            try:
                Server(autopilot, wires).run(watch)
            finally:
                daemon.kill()
    return {"key": key_of(case), **case, "death": watch.death}


class Killing:
    """Kills the daemon in the air and watches the vehicle. death: what came of it, None before."""

    def __init__(
        self, autopilot: Autopilot, daemon: subprocess.Popen[bytes], box: tuple[Floats, Floats], seed: int
    ) -> None:
        self.death: dict[str, Any] | None = None
        self._autopilot, self._daemon = autopilot, daemon
        self._after = float(np.random.default_rng((FIRST_SEED, seed, 9)).uniform(1.0, 14.0))
        self._box, self._flown_since = box, float("inf")
        self._fall: Fall | None = None
        self._killed = False

    def __call__(self) -> bool:
        """Whether the flight has been watched to its end."""
        autopilot = self._autopilot
        if self._killed and self._fall is None:
            self._fall = Fall(autopilot, self._box)
        if self._fall is not None:
            self._fall.look()
            self.death = self._fall.result if self._fall.over else None
            return self._fall.over
        height = float(autopilot.vehicle.estimate.position_world[2])
        aloft = height > ALOFT_HEIGHT and autopilot.commander.mode is Mode.OFFBOARD
        self._flown_since = min(self._flown_since, autopilot.time if aloft else float("inf"))
        if aloft and autopilot.time - self._flown_since > self._after:
            self._daemon.kill()
            self._daemon.wait()
            self._killed = True  # what it had sent before arrives with the next pass
        return self._daemon.poll() is not None and not self._killed
