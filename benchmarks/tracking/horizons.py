"""Horizons and nodes of the nominal controller: tracking error by what the flight meets, and the time of a step.

Two fast manoeuvres of the paper in lockstep, 12 s each, by motion capture. Met: nothing; the manoeuvre at 1.15 times
its speed, which saturates the rotors; a leap of the reference by 0.6 m; wind of 3 m/s on an unmodelled rotor drag; 25 %
more mass; motors that lag by 40 ms. None of it is in the vehicle file.

    python -m benchmarks tracking horizons [--seeds 1]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

from benchmarks.measurement import Page, Result, measured, options_of, paragraph_of
from dynamics.arrays import Floats
from dynamics.errors import VehicleError
from dynamics.references import Reference, named_reference
from dynamics.state import POSITION
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle
from runtime.control.controller import Controller, ControllerOptions
from simulation.lockstep import fly_reference
from vehicles import FOLDER

HORIZONS = ((0.5, 10), (0.7, 14), (1.0, 20), (0.7, 10), (1.0, 10))  # s, nodes
DEFAULT = (1.0, 20)
MANOEUVRES = ("WarpedEllipse_2", "TransposedParabola")
DURATION, LEAP, LEAP_TIME, FASTER = 12.0, 0.6, 6.0, 1.15  # s, m, s, factor
MET: Mapping[str, tuple[EffectUse, ...]] = {
    "nothing": (),
    "saturation": (),
    "leap": (),
    "wind": (EffectUse("rotor_drag", {"coefficient": 2.2e-5}), EffectUse("wind", {"x": 3.0, "y": 0.0, "z": 0.0})),
    "payload": (EffectUse("mass", {"ratio": 1.25}),),
    "lag": (EffectUse("motor_lag", {"time_constant": 0.04}),),
}
STEPS = 400  # of the solver, whose time is measured


class Leaping:
    """A reference that leaps sideways once."""

    def __init__(self, reference: Reference) -> None:
        self._reference, self.duration, self.name = reference, reference.duration, reference.name

    def states(self, times: Floats) -> Floats:
        """(n, 13) states."""
        states = self._reference.states(times)
        states[:, POSITION.start] += LEAP * (times >= LEAP_TIME)
        return states

    def inputs(self, times: Floats) -> Floats:
        """(n, rotors) rotor speeds, rad/s."""
        return self._reference.inputs(times)


def vehicle_with(horizon: float, nodes: int) -> Vehicle:
    """The paper's vehicle with another horizon."""
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    settings = msgspec.structs.replace(vehicle.controller, horizon=horizon, nodes=nodes)
    return msgspec.structs.replace(vehicle, controller=settings)


def horizons(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__, jobs=2, resumes="horizons", seeds=1)
    chosen = parser.parse_args(words)
    cases = [
        {"horizon": horizon, "nodes": nodes, "met": met, "manoeuvre": manoeuvre, "seed": seed}
        for seed in range(chosen.seeds)
        for manoeuvre in MANOEUVRES
        for met in MET
        for horizon, nodes in HORIZONS
    ]
    results = measured(flown, cases, chosen, lambda r: f"{r['key']}: {r['rmse']:.4f} m {r['ended']}", key_of=key_of)
    note = "Medians over the manoeuvres, m; in brackets over that of 1 s with 20 nodes, and flights that ended early."
    parts = [paragraph_of(__doc__), _table(results), note, "## Manoeuvre by manoeuvre", _each(results)]
    return Page("horizons", "The controller's horizon", "\n\n".join(parts))


def key_of(case: Mapping[str, Any]) -> str:
    """Key of a case."""
    return f"{case['horizon']:g} s {case['nodes']} {case['met']} {case['manoeuvre']} {case['seed']}"


def flown(case: Mapping[str, Any]) -> dict[str, Any]:
    """A flight: tracking error, m, and why it ended early."""
    vehicle = vehicle_with(case["horizon"], case["nodes"])
    faster = f":speed={FASTER}" if case["met"] == "saturation" else ""
    reference = named_reference(f"{case['manoeuvre']}{faster}", vehicle, duration=DURATION)
    path: Any = Leaping(reference) if case["met"] == "leap" else reference
    try:
        flight = fly_reference(vehicle, path, effects=MET[case["met"]], seed=case["seed"])
    except VehicleError as error:
        return {"key": key_of(case), **case, "rmse": float("nan"), "ended": str(error)}
    return {"key": key_of(case), **case, "rmse": flight.position_rmse, "ended": flight.aborted}


def _of(results: Sequence[Result], horizon: tuple[float, int], met: str) -> list[Result]:
    return [r for r in results if (r["horizon"], r["nodes"]) == horizon and r["met"] == met]


def _table(results: Sequence[Result]) -> str:
    rows = ["horizon | nodes | prepare, us | feedback, us | " + " | ".join(MET), " | ".join(["---"] * (4 + len(MET)))]
    usual = {met: np.nanmedian([r["rmse"] for r in _of(results, DEFAULT, met)] or [np.nan]) for met in MET}
    for horizon in HORIZONS:
        cells = []
        for met in MET:
            each = _of(results, horizon, met)
            error = np.nanmedian([r["rmse"] for r in each] or [np.nan])
            ended = sum(bool(r["ended"]) for r in each)
            cells.append(f"{error:.4f} ({error / usual[met]:.2f}{f', {ended} ended' if ended else ''})")
        prepare, feedback = step_time(*horizon)
        rows.append(f"{horizon[0]:g} s | {horizon[1]} | {prepare:.0f} | {feedback:.0f} | " + " | ".join(cells))
    return "\n".join(f"| {row} |" for row in rows)


def _each(results: Sequence[Result]) -> str:
    names = [f"{horizon:g} s, {nodes}" for horizon, nodes in HORIZONS]
    rows = ["manoeuvre | met | " + " | ".join(names), " | ".join(["---"] * (2 + len(names)))]
    for manoeuvre in MANOEUVRES:
        for met in MET:
            cells = []
            for horizon in HORIZONS:
                each = [r for r in _of(results, horizon, met) if r["manoeuvre"] == manoeuvre]
                mean = np.mean([r["rmse"] for r in each] or [np.nan])
                cells.append(f"{mean:.4f}{' ended' if any(r['ended'] for r in each) else ''}")
            rows.append(f"{manoeuvre} | {met} | " + " | ".join(cells))
    return "\n".join(f"| {row} |" for row in rows)


def step_time(horizon: float, nodes: int) -> tuple[float, float]:
    """Preparation and feedback, us, tenth percentile of some steps: other programs take the processor as well."""
    vehicle = vehicle_with(horizon, nodes)
    controller = Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle))
    reference = named_reference("Lemniscate", vehicle, duration=DURATION)
    state, times = reference.states(np.array([4.0]))[0], []
    controller.reset(state, 0.0)
    for tick in range(STEPS):
        now = 4.0 + 0.01 * tick
        states, inputs = reference.states(controller.node_times(now)), reference.inputs(controller.node_times(now))
        controller.prepare(states, inputs[:-1])
        controller.feedback(controller.compensate(reference.states(np.array([now]))[0], now - 0.02, now), now)
        report = controller.solver.report
        times.append((1e6 * report.prepare_seconds, 1e6 * report.feedback_seconds))
    prepare, feedback = np.percentile(times, 10, axis=0)
    return float(prepare), float(feedback)
