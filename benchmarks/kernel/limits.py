"""Feedback where limits on body rates, speed, thrust and box act, and references leap, by seeded flights.

The plant is the model. Each flight draws how far its reference leaps every 0.3 s (up to 2 m), and at every tick the
state differs from the expected one by a draw whose deviation is the flight's: up to 10 mm, 50 mm/s, 0.3 degrees and 0.1
rad/s. Rows are those of the QP: every bounded state and thrust at every node. A row acts if its multiplier exceeds its
slack.

The quadratic programs of some flights are solved by peers as well, those that are installed (pip install daqp osqp);
CasADi brings HPIPM (with a generic BLASFEO) and qpOASES. Peers get each row's excess as a variable, but for HPIPM,
which has soft rows. They start from nothing; box_qp.h from its preparation, as in flight.

    python -m benchmarks kernel limits --problems 1000000     seven minutes
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import scipy.sparse as sp

from benchmarks.kernel.flight import DT, PERIODS, lemniscate, undisturbed
from benchmarks.measurement import Page, options_of
from dynamics.arrays import Floats
from dynamics.model import build_model
from dynamics.vehicle import Limits
from dynamics.vehicle_file import read_vehicle
from fixtures.box_programs import BoxProgram, BoxSolvers, SoftRows
from runtime.control.rti.problem import Problem, fill_options
from runtime.control.rti.processor import native_processor
from runtime.control.rti.solver import CUT, RtiSolver
from vehicles import FOLDER

VEHICLE = read_vehicle(FOLDER / "arpl_250g.toml")
TICKS = 400
LEAP, LEAP_TICKS = 2.0, 30  # m
NOISE = np.repeat([0.01, 0.05, 0.0025, 0.1], [3, 3, 4, 3])  # of position, velocity, attitude, rate
MANY = 100  # rows that act
PEER_EVERY = 20  # programs of the last flights
Answer = tuple[float, np.ndarray]

CASES = {
    "rates of the file": VEHICLE.limits,
    "narrow rates": Limits(rate=(4.0, 4.0, 2.0)),
    "rates, speed, thrust, box": Limits(
        rate=(5.0, 5.0, 2.0),
        speed=2.5,
        thrust=(0.4 * VEHICLE.weight, 1.6 * VEHICLE.weight),
        box=((-1.2, -0.7, 0.5), (1.2, 0.7, 1.5)),
    ),
    "narrow throughout": Limits(
        rate=(2.0, 2.0, 1.0),
        speed=1.5,
        thrust=(0.6 * VEHICLE.weight, 1.3 * VEHICLE.weight),
        box=((-0.8, -0.5, 0.7), (0.8, 0.5, 1.3)),
    ),
}


@dataclass
class Flights:
    """Ticks of one case's flights: status, iterations, rows that act, seconds of feedback and step, by tick."""

    rows: int
    ticks: list[tuple[int, int, int, float, float]]
    programs: list[tuple[BoxProgram, np.ndarray]]


def fly(limits: Limits, problems: int, first_seed: int, *, peers: bool) -> Flights:
    """So many quadratic programs of flights with limits; `peers`: with some of the programs."""
    model = build_model(msgspec.structs.replace(VEHICLE, limits=limits))
    solver = RtiSolver(model, Problem())
    flights = Flights(row_count(solver), [], [])
    for flight in range(-(-problems // TICKS)):
        for tick, (expected, state) in enumerate(ticks(solver, first_seed + flight)):
            before = solver.inputs.copy()
            with undisturbed():
                solver.prepare(expected)
                status = solver.feedback(state)
            report = solver.report
            step = report.prepare_seconds + report.feedback_seconds
            flights.ticks.append((status, report.iterations, report.rows, report.feedback_seconds, step))
            if peers and tick % PEER_EVERY == 0 and report.iterations:
                flights.programs.append(_program(solver, expected, state, before))
    return flights


def ticks(solver: RtiSolver, seed: int) -> Iterator[tuple[Floats, Floats]]:
    """The states expected and measured (nx,) of each tick of a flight, before its preparation, which the caller does.

    The solver has the references of the tick.
    """
    model, plant = solver.model, RtiSolver(solver.model, Problem())
    states, thrusts = lemniscate(PERIODS["5.1"])
    speeds = np.sqrt(VEHICLE.body.mass * thrusts / 4 / VEHICLE.rotors.thrust_constant)
    rng = np.random.default_rng(seed)
    leap, noise = LEAP * rng.uniform(), NOISE * rng.uniform()
    start = rng.integers(0, len(states) - TICKS - 200)
    state = model.initial_state(states[start].copy())
    solver.reset(state)
    moved = np.zeros(3)
    for tick in range(TICKS):
        if tick % LEAP_TICKS == 0:
            moved = leap * rng.uniform(-1, 1, 3)
        nodes = start + tick + np.rint(solver.problem.offsets / DT).astype(int)
        solver.state_reference[:, :13], solver.input_reference[:] = states[nodes], speeds[nodes[:-1], None]
        solver.state_reference[:, :3] += moved
        expected = solver.propagate(state, solver.inputs[0], DT).copy()
        solver.shift(DT)
        state = plant.propagate(state, solver.inputs[0], DT) + noise * rng.normal(size=13)
        state[6:10] /= np.linalg.norm(state[6:10])
        yield expected, state
        if np.linalg.norm(state[:3] - states[start + tick, :3]) > 3 * LEAP:
            break  # a reference that leaps by metres from fast flight is not one that every flight follows


def row_count(solver: RtiSolver) -> int:
    options = fill_options(solver.problem, solver.model)
    bounded = np.count_nonzero(np.isfinite(options.x_upper)) + bool(np.isfinite(options.thrust_upper))
    return int(bounded) * solver.problem.nodes


def _program(
    solver: RtiSolver, expected: np.ndarray, state: np.ndarray, before: np.ndarray
) -> tuple[BoxProgram, np.ndarray]:
    """The last program, and the gradient that was expected."""
    options, count = fill_options(solver.problem, solver.model), row_count(solver)
    size, nodes = solver.gradient.size, solver.problem.nodes
    lower, upper = (np.tile(list(bound), nodes) for bound in (options.u_lower, options.u_upper))
    room = [(bound - before.ravel()) / options.scale for bound in (lower, upper)]
    rows = solver.rows[:count, :size].copy()
    bounds = [solver.row_bounds[side, :count].copy() for side in (1, 0)]
    soft = SoftRows(rows, bounds[0], bounds[1], solver.problem.soft_penalty)
    program = BoxProgram(solver.hessian.copy(), solver.measured_gradient.copy(), *room, soft)
    return program, solver.gradient.copy()


def with_excess(program: BoxProgram) -> tuple[Any, ...]:
    """H, g, A, lower and upper of the program with a variable for each row's excess; bounds on variables are rows."""
    soft, size = program.soft, program.gradient.size
    assert soft is not None
    count = len(soft.lower)
    hessian = sp.block_diag([program.hessian, soft.penalty * sp.eye(count)], format="csc")
    gradient = np.concatenate([program.gradient, np.full(count, soft.penalty)])
    eye, far = sp.eye(count), np.full(count, 1e8)
    rows = sp.vstack([sp.hstack([soft.rows, -eye]), sp.hstack([soft.rows, eye])], format="csc")
    lower = np.concatenate([program.lower, np.zeros(count), -far, soft.lower])
    upper = np.concatenate([program.upper, far, soft.upper, far])
    every = sp.vstack([sp.eye(size + count), rows], format="csc")
    return hessian, gradient, every, lower, upper


def solved_by(name: str, program: BoxProgram, expected: np.ndarray, solvers: BoxSolvers) -> Answer:
    """Seconds and the first part of the solution (n,) by one of the peers; NaN where it failed."""
    size, failed = program.gradient.size, np.full(program.gradient.size, np.nan)
    defaults = Problem()
    if name == "box_qp.h":
        answer = solvers.solve(
            program, tolerance=defaults.tolerance, max_iterations=defaults.iterations, expected=expected
        )
        return answer.seconds, answer.v
    if name == "box_qp.h, not cut":
        answer = solvers.solve(program, tolerance=defaults.tolerance, expected=expected)
        return answer.seconds, answer.v if answer.status == 0 else failed
    if name.startswith("HPIPM"):
        answer = solvers.solve(program, tolerance=1e-5, max_iterations=50, by="hpipm")
        return answer.seconds, answer.v if answer.status == 0 else failed
    hessian, gradient, rows, lower, upper = with_excess(program)
    if name == "qpOASES":
        variables = gradient.size
        general = rows[variables:].toarray()
        structure = {"h": ca.Sparsity.dense(variables, variables), "a": ca.Sparsity.dense(*general.shape)}
        solver = ca.conic("peer", "qpoases", structure, {"printLevel": "none", "error_on_fail": False})
        bounds = {
            "lbx": lower[:variables],
            "ubx": upper[:variables],
            "lba": lower[variables:],
            "uba": upper[variables:],
        }
        result = solver(h=hessian.toarray(), g=gradient, a=general, **bounds)
        stats = solver.stats()
        v = np.array(result["x"]).ravel()[:size]
        return stats["t_wall_solver"], v if stats["success"] else failed
    module: Any = importlib.import_module(name.lower())
    if name == "DAQP":
        general = rows[gradient.size :].toarray()
        v, _, flag, info = module.solve(
            hessian.toarray(), gradient, general, upper, lower, np.zeros(upper.size, np.int32)
        )
        return info["solve_time"], np.array(v)[:size] if flag == 1 else failed
    osqp = module.OSQP()
    settings = {"verbose": False, "eps_abs": 1e-4, "eps_rel": 1e-4}
    try:
        osqp.setup(sp.triu(hessian, format="csc"), gradient, rows, lower, upper, **settings)
        result = osqp.solve()
    except module.OSQPException:
        return np.nan, failed
    return result.info.solve_time, result.x[:size] if result.info.status == "solved" else failed


def peer_names() -> list[str]:
    """Peers that are installed."""
    names = ["box_qp.h", "box_qp.h, not cut", "HPIPM, BLASFEO generic", "qpOASES"]
    for name in ("DAQP", "OSQP"):
        try:
            importlib.import_module(name.lower())
        except ImportError:
            continue
        names.append(name)
    return names


def peer_table(programs: Sequence[tuple[BoxProgram, np.ndarray]]) -> str:
    """Times of the peers, and how often a peer lacks 1e-3 of the best cost's distance to that of the expected plan."""
    rows = max(len(program.soft.lower) for program, _ in programs if program.soft is not None)
    solvers = BoxSolvers(programs[0][0].gradient.size, native_processor(), rows)
    names, seconds, costs = peer_names(), dict[str, list[float]](), dict[str, list[float]]()
    for program, expected in programs:
        for name in names:
            with undisturbed():
                took, v = solved_by(name, program, expected, solvers)
            inside = np.clip(v, program.lower, program.upper)
            seconds.setdefault(name, []).append(took)
            costs.setdefault(name, []).append(program.cost(inside) if np.isfinite(inside).all() else np.inf)
    best = np.min(np.array(list(costs.values())), axis=0)
    lines = [
        "| solver | us, median | p99 | worst | no answer | cost above the best by more than 0.1 % |",
        "| --- " * 6 + "|",
    ]
    for name in names:
        took, cost = 1e6 * np.array(seconds[name]), np.array(costs[name])
        above = np.isfinite(cost) & (cost > best + 1e-3 * np.abs(best))
        marks = " | ".join(f"{np.nanpercentile(took, share):.0f}" for share in (50, 99, 100))
        lines.append(f"| {name} | {marks} | {np.count_nonzero(~np.isfinite(cost))} | {np.count_nonzero(above)} |")
    return "\n".join(lines)


def case_row(name: str, flights: Flights) -> str:
    """A case's row of the table."""
    status, iterations, acting, feedback, step = np.array(flights.ticks).T
    took = 1e6 * feedback
    shares = " | ".join(f"{np.percentile(took, share):.0f}" for share in (50, 99, 99.9, 100))
    many = took[acting >= MANY]
    worst = f"{many.max():.0f} ({many.size})" if many.size else "-"
    ratio = step.max() / np.median(step)
    return (
        f"| {name} | {len(status)} | {flights.rows} | {np.median(acting):.0f} | {acting.max():.0f} | "
        f"{np.median(iterations):.0f} | {iterations.max():.0f} | {shares} | {worst} | "
        f"{1e6 * np.median(step):.0f} | {ratio:.1f} | {100 * np.mean(status == CUT):.2f} | "
        f"{np.count_nonzero(status > CUT) + np.count_nonzero(status < 0)} |"
    )


HEADER = (
    "limits", "programs", "rows", "acting, median", "most", "iterations, median", "most", "feedback us, median", "p99",
    "p99.9", "worst", f"worst with {MANY} rows acting (programs)", "step us, median", "worst step / median", "cut %",
    "failed",
)  # fmt: skip


def limits(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__, problems=100_000, seed=0)
    arguments = parser.parse_args(words)
    lines, programs = [f"| {' | '.join(HEADER)} |", "| --- " * len(HEADER) + "|"], list[tuple[BoxProgram, np.ndarray]]()
    start = time.monotonic()
    for name, bounds in CASES.items():
        each = arguments.problems // len(CASES)
        flights = fly(bounds, each, arguments.seed, peers=False)
        programs += fly(bounds, min(4 * TICKS, each), arguments.seed + 10**6, peers=True).programs
        lines.append(case_row(name, flights))
        print(lines[-1], f"after {time.monotonic() - start:.0f} s", flush=True)
    text = f"{Problem().iterations} iterations at most. Other programs of this machine are in the worst times."
    peers = f"{len(programs)} of these programs, by peers:\n\n{peer_table(programs)}"
    return Page(
        "limits", "Feedback with the vehicle file's limits acting, one core", "\n".join([*lines, "", text, "", peers])
    )
