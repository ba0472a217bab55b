"""Recorded ticks of a kernel, and their repetition on the computer that will fly it.

`alula export` records ticks of a flight towards a place two metres away, and the answers of a kernel that was proven
there. `alula export --verify` feeds them to the bundle's own kernel, on the processor that it was compiled for.
"""

from __future__ import annotations

import io
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec
import numpy as np

from dynamics.array_file import read_arrays
from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from dynamics.state import RIGID_BODY_STATES
from runtime.control.bundle import KERNEL, PHYSICS, TICKS, Bundle
from runtime.control.rti.solver import RtiSolver

RECORDED = (0, 3, 10, 20, 40, 90)  # ticks from hover on
STEP = 2.0  # m to the place that the recorded flight goes to: rotors and soft limits act
PERIOD = 0.01  # s between recorded ticks
EXPORT_AGAIN = "Export the model again."
REPETITIONS = 300  # of a tick, to measure its time
ARGUMENTS = ("parameters", "environment", "history", "inputs", "state_reference", "input_reference")
ANSWERS = ("states", "hessian", "gradient", "solution")
# of the greatest answer of its kind in a tick; the solution is as exact as the quadratic program is solved
TOLERANCES: Mapping[str, Mapping[str, float]] = {
    "double": {"states": 1e-9, "hessian": 1e-8, "gradient": 1e-8, "solution": 1e-3},
    "float": {"states": 2e-5, "hessian": 5e-4, "gradient": 5e-4, "solution": 1e-3},
}


class Agreement(msgspec.Struct, frozen=True):
    """The greatest difference of a kernel's answers from the recorded ones, as a share of the greatest answer.

    kernel: file.
    answer: "states", "hessian", "gradient", or the "solution", which are the new rotor speeds.
    """

    kernel: str
    answer: str
    error: float
    tolerance: float

    @property
    def holds(self) -> bool:
        """Whether it is within the tolerance; false for NaN."""
        return self.error <= self.tolerance


class Timing(msgspec.Struct, frozen=True):
    """Time of a kernel's ticks, preparation and feedback, s. period: of the vehicle's controller."""

    kernel: str
    median: float
    p99: float
    longest: float
    period: float

    @property
    def holds(self) -> bool:
        """Whether half of the period is left for link and flight logic, in the median: p99 shows other programs too."""
        return self.median <= self.period / 2


class Verification(msgspec.Struct, frozen=True):
    """Answers of a bundle's kernels on this computer."""

    processor: str
    ticks: int
    agreements: tuple[Agreement, ...]
    timings: tuple[Timing, ...]

    @property
    def lines(self) -> tuple[str, ...]:
        """For a terminal."""
        agreed = (
            f"{a.kernel}: {a.answer} as at the export to {a.error:.1e} (<= {a.tolerance:g})" for a in self.agreements
        )
        timed = (
            f"{t.kernel}: a tick takes {1e3 * t.median:.2f} ms, p99 {1e3 * t.p99:.2f}, longest {1e3 * t.longest:.2f}, "
            f"of {1e3 * t.period:g} ms"
            for t in self.timings
        )
        return (f"kernel for {self.processor}, {self.ticks} recorded ticks", *agreed, *timed)

    def require(self) -> None:
        """Raises DataError naming what does not hold."""
        wrong = [
            f"{a.answer} of {a.kernel} differ by {a.error:.2g} (allowed: {a.tolerance:g})"
            for a in self.agreements
            if not a.holds
        ]
        slow = [
            f"{t.kernel} takes {1e3 * t.median:.2f} ms, more than half of the period of {1e3 * t.period:g} ms"
            for t in self.timings
            if not t.holds
        ]
        if wrong:
            raise DataError(
                f"the kernel does not answer here as at its export: {'; '.join(wrong)}. Do not fly it; export the "
                "model again with this alula, and report it if it stays."
            )
        if slow:
            raise DataError(
                f"this computer is too slow: {'; '.join(slow)}. Stop other programs, export with fewer --nodes or a "
                "smaller network, or set [controller] rate lower."
            )


def record_ticks(solvers: Mapping[str, RtiSolver]) -> bytes:
    """Ticks and answers of solvers by the name of their kernel's file, as an .npz file."""
    arrays = {
        f"{kernel}/{tick}/{name}": value
        for kernel, solver in solvers.items()
        for tick, values in _flight(solver)
        for name, value in values.items()
    }
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


def verify_bundle(bundle: Bundle) -> Verification:
    """Repeat the recorded ticks of a bundle that `read_bundle` has let through.

    Raises RequestError for a bundle without recorded ticks.
    """
    ticks = read_ticks(bundle.folder / TICKS)
    manifest, problem = bundle.manifest, bundle.manifest.problem
    solvers = {KERNEL: (RtiSolver(bundle.model, problem, bundle.kernel), manifest.precision)}
    if manifest.learned:
        solvers[PHYSICS] = (RtiSolver(bundle.vehicle_model, problem, bundle.physics), "double")
    count, agreements, timings = 0, list[Agreement](), list[Timing]()
    for kernel, (solver, precision) in solvers.items():
        recorded = ticks.get(kernel, {})
        if not recorded:
            raise RequestError(f"{bundle.folder / TICKS} holds no tick of {kernel}. Export the model again.")
        count += len(recorded)
        for answer, tolerance in TOLERANCES[precision].items():
            errors = [difference(_repeat(solver, tick)[answer], tick[answer]) for tick in recorded.values()]
            agreements.append(Agreement(kernel, answer, float(np.max(errors)), tolerance))
        timings.append(_timing(kernel, solver, list(recorded.values()), 1 / bundle.vehicle.controller.rate))
    return Verification(manifest.processor, count, tuple(agreements), tuple(timings))


def _flight(solver: RtiSolver) -> Iterator[tuple[int, dict[str, Floats]]]:
    """Arguments and answers of the recorded ticks of a flight in the model itself."""
    model, speed = solver.model, solver.trim.rotor_speed
    state = model.initial_state(np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6]))
    solver.reset(state)
    solver.state_reference[:], solver.input_reference[:] = state, speed
    solver.state_reference[:, 0] = STEP
    solver.history[:] = np.concatenate([state[:RIGID_BODY_STATES], speed])
    for tick in range(RECORDED[-1] + 1):
        arguments = {name: getattr(solver, name).copy() for name in ARGUMENTS} | {"state": state.copy()}
        answers = _tick(solver, state)
        if not all(np.isfinite(answer).all() for answer in answers.values()):
            return  # an untrained network need not fly
        if tick in RECORDED:
            yield tick, arguments | answers
        column = np.concatenate([state[:RIGID_BODY_STATES], solver.inputs[0]])
        state = solver.propagate(state, solver.inputs[0], PERIOD).copy()
        solver.history[:] = np.vstack([solver.history[1:], column])[: len(solver.history)]
        solver.shift(PERIOD)


def _tick(solver: RtiSolver, state: Floats) -> dict[str, Floats]:
    solver.assess(state, solver.inputs[0])
    solver.prepare(state)
    prepared = {name: getattr(solver, name).copy() for name in ANSWERS[:3]}
    solver.feedback(state)
    return prepared | {"solution": solver.inputs.copy()}


def _repeat(solver: RtiSolver, tick: Mapping[str, Floats]) -> dict[str, Floats]:
    for name in ARGUMENTS:
        getattr(solver, name)[:] = tick[name]
    return _tick(solver, tick["state"])


def difference(answer: Floats, recorded: Floats) -> float:
    """Of an answer from the recorded one, as a share of the greatest recorded value."""
    return float(np.abs(answer - recorded).max() / max(np.abs(recorded).max(), 1e-12))


def _timing(kernel: str, solver: RtiSolver, ticks: list[dict[str, Floats]], period: float) -> Timing:
    seconds = []
    for repetition in range(REPETITIONS):
        tick = ticks[repetition % len(ticks)]
        for name in ARGUMENTS:
            getattr(solver, name)[:] = tick[name]
        start = time.perf_counter()
        solver.assess(tick["state"], solver.inputs[0])
        solver.prepare(tick["state"])
        solver.feedback(tick["state"])
        seconds.append(time.perf_counter() - start)
    median, p99, longest = (float(value) for value in np.percentile(seconds[len(ticks) :], (50, 99, 100)))
    return Timing(kernel, median, p99, longest, period)


def read_ticks(path: Path) -> dict[str, dict[str, dict[str, Floats]]]:
    """Arrays by kernel, tick and name. Raises RequestError for a file that is damaged."""
    ticks: dict[str, dict[str, dict[str, Floats]]] = {}
    for key, value in read_arrays(path, advice=EXPORT_AGAIN).items():
        try:
            kernel, tick, name = key.split("/")
        except ValueError:
            raise RequestError(f"cannot read {path}: {key!r} is no KERNEL/TICK/NAME. {EXPORT_AGAIN}") from None
        ticks.setdefault(kernel, {}).setdefault(tick, {})[name] = value
    return ticks
