"""A vehicle that is not ours, flown by the runtime's own logic: tracking and named wind. Writes results/witness.md.

`witness_vehicle` shares no formula with this project. Settings were chosen on the mock's vehicle, and none is changed
here. Finished flights are kept, so that a run that was stopped resumes.

    python -m benchmarks adaptation witness --seeds 3
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.adaptation.witness_vehicle import FULL_THRUST, GRAVITY, MASS, STEP, WitnessVehicle
from benchmarks.measurement import Page, measured, options_of
from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.references import named_reference
from dynamics.state import POSITION
from dynamics.vehicle_file import read_vehicle
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight.composition import Controllers, build_flyer
from runtime.flight.decision import FlyerSettings
from runtime.flight.engagement import EngagementSettings
from runtime.flight.health import HealthLimits
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from runtime.flight_setup import FOLLOWED
from runtime.link.estimate import StateEstimate
from simulation.lockstep import quiet_observation
from vehicles import FOLDER

VEHICLE = "arpl_250g"  # whose file the controller has; it has no drag
AIR: Mapping[str, tuple[float, float]] = {"still": (0.0, 0.0), "4 m/s": (4.0, 0.3), "8 m/s": (8.0, 0.5)}  # wind, gust
DIRECTION = np.array([0.8, -0.6, 0.0])
MANOEUVRES = ("hover", "circle", "Ellipse_1", "Lemniscate:speed=0.7")
MODES = {"file": ("off", ()), "disturbance": ("on", ()), "named": ("on", FOLLOWED)}
SECONDS, COUNTED, PATIENCE = 24.0, 6.0, 60.0  # s: of a reference, from which on errors count, of a flight
FIRST_SEED = 71_000
SHOWN = 3.0  # m/s, deviation of a wind that a flight shows: a third of its prior's
SPEED = 1239.0  # rad/s, of the file's rotors in hover
HOVER = MASS * GRAVITY / (4 * FULL_THRUST)  # of the collective thrust, until the flyer takes over
CURVE = 1.0  # the autopilot's THR_MDL_FAC: its motors take the root of the share of thrust


@dataclass(frozen=True)
class Case:
    """A flight."""

    air: str
    reference: str
    mode: str
    seed: int

    @property
    def key(self) -> str:
        """Unique name."""
        return f"{self.air}, {self.reference}, {self.mode}, {self.seed}"


def flown(case: Case) -> dict[str, Any]:
    """Errors of a flight, m, and what was estimated."""
    vehicle = read_vehicle(FOLDER / f"{VEHICLE}.toml")
    mode, follow = MODES[case.mode]
    settings = AdaptationSettings(mode=mode, follow=follow)  # type: ignore[arg-type]
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, adaptation=settings))
    reference = named_reference(case.reference, vehicle, duration=SECONDS)
    speed, gust = AIR[case.air]
    start = reference.states(np.zeros(1))[0]
    plant = WitnessVehicle(start[POSITION], wind=np.zeros(3), gust=0.0, seed=FIRST_SEED + case.seed)
    health = HealthLimits.for_vehicle(vehicle)
    flyer_settings = FlyerSettings(period=CONTROL_PERIOD, engagement=EngagementSettings(resume=True), health=health)
    flyer = build_flyer(Controllers(controller), reference, Plan(), flyer_settings, thrust_curve=CURVE)
    errors: list[tuple[float, float]] = []
    ended, tick = "", 0
    while not ended and plant.time < PATIENCE:
        now = round(plant.time, 3)
        taken, state = plant.estimate
        force = plant.accelerometer
        observation = quiet_observation(
            tick,
            now,
            specific_force_z=float(force[2]),
            specific_force_xy=force[:2],
            engage=tick == 0,
            rotor_time=now,
            rotor_speed=plant.rotor_speed,
            rotors_measured=True,
        )
        decision = flyer.step(observation, StateEstimate(round(taken, 3), now, state, 0, True, "ODOMETRY"))
        flyer.prepare(now)
        rate, thrust = np.zeros(3), HOVER
        if flyer.engagement.flying and decision.rate_body is not None:
            rate, thrust = decision.rate_body.copy(), decision.thrust
        since = now - flyer.mission.phase_started
        if flyer.mission.phase is Phase.TRACK:
            share = min(since / 3.0, 1.0)  # the air begins to move with the reference
            plant.wind, plant.gust = share * speed * DIRECTION, share * gust
            at = flyer.reference_now(now)
            if at is not None and since > COUNTED:
                away = (place - at[POSITION] for place in (plant.position, state[POSITION]))
                errors.append((*(float(a @ a) for a in away),))  # type: ignore[arg-type]
        elif flyer.mission.phase is Phase.RETURN:
            ended = "completed"
        ended = ended or flyer.mission.landing_reason or (flyer.engagement.refusal if flyer.over else "")
        plant.advance(rate, thrust, (2 + tick % 2) * STEP)  # as PX4 sends its estimates: 100 Hz in the mean
        tick += 1
    rmse = np.sqrt(np.mean(errors, axis=0)) if errors else np.full(2, np.nan)
    adaptation = controller.adaptation
    followed = {} if adaptation is None else adaptation.followed.parameters
    return {
        **asdict(case),
        "key": case.key,
        "rmse": float(rmse[0]),
        "by_estimate": float(rmse[1]),
        "largest": max((true for true, _ in errors), default=float("nan")) ** 0.5,
        "ended": ended,
        "events": {event.value: count for event, count in flyer.events.counts.items() if count},
        "effectiveness": flyer.effectiveness.value,
        "parameters": {name: [value.value, value.std] for name, value in followed.items()},
    }


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Tracking by air and manoeuvre, then what was named."""
    body = [
        f"Position error, cm RMS, from {COUNTED:g} s on of {SECONDS:g} s: median of "
        f"{len({r['seed'] for r in results})} seeds (worst). True, with the estimator's errors, and by the estimate, "
        f"without them. The controller has the file of {VEHICLE}: no drag, no wind, 5 % other inertia and 2 % other "
        "thrust than the vehicle that flies.",
        "",
        "| air | reference | true: file's model | disturbance | and named | by the estimate: file's model | "
        "disturbance | and named |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for air in AIR:
        for reference in MANOEUVRES:
            some = [r for r in results if (r["air"], r["reference"]) == (air, reference)]
            cells = [
                _cell([100 * r[kind] for r in some if r["mode"] == mode])
                for kind in ("rmse", "by_estimate")
                for mode in MODES
            ]
            body.append(f"| {air} | {reference} | {' | '.join(cells)} |")
    events = sorted({event for r in results for event in r["events"]})
    counts = ", ".join(f"{event} in {sum(event in r['events'] for r in results)}" for event in events) or "none"
    early = [f"{r['key']}: {r['ended']}" for r in results if r["ended"] != "completed"]
    body += ["", f"Events in {len(results)} flights: {counts}. Ended early: {'; '.join(early) or 'none'}."]
    body += [
        "",
        "Named after a flight that shows it: away from the mean wind, m/s, and how many 95 % intervals hold; drag in "
        "hover, that of the witness being 0.43 m/s^2 per m/s from its rotors and more from its body.",
        "",
        "| air | reference | shown | wind.x away | wind.y away | hold | wind.z | rotor drag in hover, 1/s |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for air, (speed, _) in AIR.items():
        for reference in MANOEUVRES[1:]:
            body.append(f"| {air} | {reference} | {' | '.join(_named(results, air, reference, speed))} |")
    return "\n".join(body)


def _named(results: Sequence[Mapping[str, Any]], air: str, reference: str, speed: float) -> list[str]:
    some = [r["parameters"] for r in results if (r["air"], r["reference"], r["mode"]) == (air, reference, "named")]
    shown = [p for p in some if p["wind.x"][1] < SHOWN]
    if not shown:
        return [f"0 of {len(some)}", *[""] * 5]
    true = dict(zip(("wind.x", "wind.y"), (speed * DIRECTION).tolist(), strict=False))
    away = {name: [p[name][0] - value for p in shown] for name, value in true.items()}
    holds = sum(abs(p[name][0] - value) <= 1.96 * p[name][1] for p in shown for name, value in true.items())
    drag = [p["rotor_drag.coefficient"][0] * 4 * SPEED / MASS for p in shown]
    return [
        f"{len(shown)} of {len(some)}",
        *(f"{np.median(values):.2f}" for values in away.values()),
        f"{holds} of {2 * len(shown)}",
        f"{np.median([p['wind.z'][0] for p in shown]):.2f}",
        f"{np.median(drag):.2f}",
    ]


def _cell(values: Sequence[float]) -> str:
    return f"{float(np.median(values)):.1f} ({max(values):.1f})" if values else ""


def witness(words: Sequence[str]) -> Page:
    """Tracking of a vehicle that shares no formula with this project. Writes results/witness.md.

    python -m benchmarks adaptation witness --seeds 3
    """
    options = options_of(__doc__, resumes="witness", jobs=1, seeds=3).parse_args(words)
    cases = [
        Case(air, reference, mode, seed)
        for seed in range(options.seeds)
        for air in AIR
        for reference in MANOEUVRES
        for mode in MODES
    ]
    results = measured(flown, cases, options, spoken, key_of=lambda case: case.key)
    return Page("witness", "A vehicle that is not ours", table(results))


def spoken(result: Mapping[str, Any]) -> str:
    """A line about a flight."""
    return f"{result['key']}: {100 * result['rmse']:.2f} cm {result['ended']} {result['events']}"
