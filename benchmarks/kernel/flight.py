"""The flight behind the kernel's benchmarks: lemniscates in lockstep, and the networks that fly them.

The plant has motor lag (40 ms) and drag; the networks are trained on it by `network_worker.py` where a folder does not
hold them yet (three minutes).
"""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.kernel.network_worker import DT, LAG_AND_DRAG, Plant
from benchmarks.measurement import ROOT
from dynamics.model import build_model
from dynamics.vehicle import GRAVITY, Limits
from export.kernel import kernel_solver
from export.trained import ExportedModel
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import Processor
from runtime.control.rti.solver import RtiSolver

NETWORKS = ROOT / "build" / "rti_network"
STEPS = 8000
SECONDS = 9.0
PERIODS = {"3.6": 5.0, "5.1": 3.5}  # m/s at most: s of a lemniscate's lap
PARTS = ("rollout", "tangent", "condense", "prepare", "feedback")
Watch = Callable[[RtiSolver, np.ndarray], None]


def networks(folder: Path = NETWORKS, steps: int = STEPS) -> Path:
    """Train what is not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind in ("pi_tcn", "pi_mlp"):
        if not (folder / f"{kind}.pt").exists():
            worker = [sys.executable, "-m", "benchmarks.kernel.network_worker", kind]
            subprocess.run([*worker, str(folder / f"{kind}.pt"), "--steps", str(steps)], check=True)
    return folder


def unlimited(model: ExportedModel) -> ExportedModel:
    """Model without limits on body rates, which the prototype's problem did not have."""
    return dataclasses.replace(model, vehicle=msgspec.structs.replace(model.vehicle, limits=Limits(rate=(1e3,) * 3)))


def solver_for(model: ExportedModel, processor: Processor, problem: Problem | None = None) -> RtiSolver:
    assert model.network is not None
    return kernel_solver(model.network, unlimited(model).flight_model, problem or Problem(), processor)


def lemniscate(period: float) -> tuple[np.ndarray, np.ndarray]:
    """Thrust directions and accelerations of a 4 x 2 m lemniscate as states (n, 13) and thrusts (n,) per mass."""
    t = np.arange(0, SECONDS + 1.5, DT)
    w, ramp = 2 * np.pi / period, 1 - np.exp(-((t / 2) ** 3))
    place = np.stack([2 * np.sin(w * t) * ramp, np.sin(2 * w * t) * ramp, 1 + 0.25 * np.sin(w * t) * ramp], 1)
    velocity = np.gradient(place, DT, axis=0)
    force = np.gradient(velocity, DT, axis=0)
    force[:, 2] += GRAVITY
    size = np.linalg.norm(force, axis=1)
    z = force / size[:, None]
    attitude = np.stack([1 + z[:, 2], -z[:, 1], z[:, 0], 0 * size], 1)
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    slope = np.gradient(attitude, DT, axis=0)
    w0, x, y, zq = attitude.T
    conjugate = np.stack([w0, -x, -y, -zq], 1)
    rate = 2 * _vector_part(conjugate, slope)
    return np.concatenate([place, velocity, attitude, rate], 1), size


def _vector_part(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    a, b = left[:, 1:], right[:, 1:]
    return left[:, :1] * b + right[:, :1] * a + np.cross(a, b)


def fly(
    solver: RtiSolver, period: float, *, jumps: float = 0.0, watch: Watch | None = None
) -> tuple[float, np.ndarray, np.ndarray]:
    """RMSE (cm, after 2 s), seconds of each iteration's parts (n, 5) and QP iterations (n,).

    jumps: m by which the reference leaps every 0.3 s, so that motors saturate. watch: called
    before every iteration with the solver, its references and history filled in, and the state.
    """
    vehicle = solver.model.vehicle
    states, thrusts = lemniscate(period)
    speeds = np.sqrt(vehicle.body.mass * thrusts / 4 / vehicle.rotors.thrust_constant)
    plant = Plant(build_model(vehicle, effects=LAG_AND_DRAG), 1)
    plant.states[0, :13] = [*states[0, :3], 0, 0, 0, 1, *[0.0] * 6]
    rng, leap = np.random.default_rng(0), np.zeros(3)
    past = [np.concatenate([plant.states[0, :13], [vehicle.hover_speed] * 4])] * 64
    solver.reset(_full_state(solver, plant))
    errors, times, iterations = [], [], []
    for tick in range(round(SECONDS / DT)):
        if jumps and tick % 30 == 0:
            leap = jumps * rng.uniform(-1, 1, 3)
        node_ticks = tick + round(solver.problem.node / DT) * np.arange(solver.problem.nodes + 1)
        solver.state_reference[:, :13] = states[node_ticks]
        solver.state_reference[:, 0:3] += leap
        solver.input_reference[:] = speeds[node_ticks[:-1], None]
        if columns := len(solver.history):
            solver.history[:] = past[-columns:]
        if watch:
            watch(solver, plant.states[0, :13])
        with undisturbed() if jumps else nullcontext():
            solver.prepare(_full_state(solver, plant))
            solver.feedback(_full_state(solver, plant))
        report = solver.report
        times.append([getattr(report, f"{part}_seconds") for part in PARTS])
        iterations.append(report.iterations)
        past = [*past[-64:], np.concatenate([plant.states[0, :13], solver.inputs[0]])]
        plant.advance(solver.inputs[:1].copy())
        errors.append(np.linalg.norm(plant.states[0, :3] - states[tick + 1, :3]))
        if errors[-1] > 5:
            return float("inf"), np.array(times), np.array(iterations)
    late = np.array(errors[200:])
    return float(100 * np.sqrt(np.mean(late**2))), np.array(times), np.array(iterations)


@contextmanager
def undisturbed() -> Iterator[None]:
    """SCHED_FIFO for one iteration, where it is granted: worst cases are then the solver's own."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    except PermissionError:
        yield
        return
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _full_state(solver: RtiSolver, plant: Plant) -> np.ndarray:
    return solver.model.initial_state(plant.states[0, :13])
