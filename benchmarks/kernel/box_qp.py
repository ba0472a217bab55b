"""The quadratic programs of saturated flight, solved by box_qp.h, by HPIPM, and by two active-set methods.

PI-TCN, as it is bundled, follows a lemniscate whose reference leaps every 0.3 s by up to 0.6 m, in lockstep. Every
program whose optimum lies on bounds is solved by all, in turns on one core, to a tolerance of 1e-5, box_qp.h and HPIPM
from nothing and without a cut. Times are without preparations, which a flight does before the state arrives: for
box_qp.h and DAQP the factor of the Hessian. Of three runs the shortest counts. HPIPM's time depends on its BLASFEO:
CasADi's wheel has a generic one.

DAQP and qpOASES start from the active bounds of the program before, as they would in flight; DAQP also from none. DAQP
is a peer for comparison (pip install daqp) and left out where it is not installed; CasADi brings qpOASES.

    python -m benchmarks kernel box_qp      a minute
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.kernel.flight import PERIODS, fly, solver_for, undisturbed
from benchmarks.measurement import ROOT, Page, options_of, own_command
from export.trained import read_model
from fixtures.box_programs import BoxProgram, BoxSolvers
from runtime.control.rti.problem import fill_options
from runtime.control.rti.processor import native_processor
from runtime.control.rti.solver import RtiSolver
from vehicles import FOLDER

ACADOS = ROOT / ".venv-acados" / "lib"
LEAP = 0.6  # m
RUNS = 3
TOLERANCE, ITERATIONS = 1e-5, 50  # a flight goes on from a prepared point instead, and is cut
MAX_EXCESS = 1e-6  # of the cost's decrease: what a solution may lack of the best one
SOLVED = 1  # DAQP's exit flag

# a program's seconds, iterations and optimum (n,)
Answer = tuple[float, int, np.ndarray]
Solve = Callable[[BoxProgram], Answer]


def recorded(model: Path) -> list[BoxProgram]:
    """The program of every tick, at the state that its preparation expected."""
    solver = solver_for(read_model(model), native_processor())
    options, programs = fill_options(solver.problem, solver.model), list[BoxProgram]()
    lower, upper = (np.tile(list(bound), solver.problem.nodes) for bound in (options.u_lower, options.u_upper))

    def keep(flown: RtiSolver, state: np.ndarray) -> None:
        assert flown.prepare(flown.model.initial_state(state)) == 0
        room = [(bound - flown.inputs.ravel()) / options.scale for bound in (lower, upper)]
        programs.append(BoxProgram(flown.hessian.copy(), flown.gradient.copy(), *room))

    fly(solver, PERIODS["5.1"], jumps=LEAP, watch=keep)
    return programs


def ours(solvers: BoxSolvers, by: Any) -> Solve:
    def solve(program: BoxProgram) -> Answer:
        answer = solvers.solve(program, tolerance=TOLERANCE, max_iterations=ITERATIONS, by=by)
        return answer.seconds, answer.iterations, answer.v if answer.status == 0 else np.full_like(answer.v, np.nan)

    return solve


def daqp_solver(size: int, *, warm: bool) -> Solve | None:
    """DAQP (Arnstroem, Bemporad, Axehill, IEEE TAC 2022); None where it is not installed."""
    try:
        daqp: Any = importlib.import_module("daqp")
    except ImportError:
        return None
    before, no_rows = np.zeros(size, dtype=np.int32), np.zeros((0, size))

    def solve(program: BoxProgram) -> Answer:
        arguments = (program.hessian, program.gradient, no_rows, program.upper, program.lower)
        runs = [daqp.solve(*arguments, before.copy()) for _ in range(RUNS)]
        v, _, flag, result = min(runs, key=lambda run: float(run[3]["solve_time"]))
        if warm:
            before[:] = np.asarray(result["lam"])[:size] != 0  # 1: starts as active
        return result["solve_time"], result["iterations"], np.array(v) if flag == SOLVED else np.full(size, np.nan)

    return solve


def qpoases_solver(size: int) -> Solve:
    """qpOASES 3.2 in CasADi, started from the program before; one run: a second one would start at the solution."""
    structure = {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity(0, size)}
    solver = ca.conic("qpoases", "qpoases", structure, {"printLevel": "none", "error_on_fail": False})

    def solve(program: BoxProgram) -> Answer:
        answer = solver(h=program.hessian, g=program.gradient, lbx=program.lower, ubx=program.upper)
        stats, v = solver.stats(), np.array(answer["x"]).ravel()
        return stats["t_wall_solver"], stats["iter_count"], v if stats["success"] else np.full(size, np.nan)

    return solve


def peers(size: int) -> dict[str, Solve]:
    solvers = BoxSolvers(size, native_processor())
    every = {
        "box_qp.h": ours(solvers, "box_qp"),
        "HPIPM": ours(solvers, "hpipm"),
        "DAQP": daqp_solver(size, warm=False),
        "DAQP, warm": daqp_solver(size, warm=True),
        "qpOASES, warm": qpoases_solver(size),
    }
    return {name: solve for name, solve in every.items() if solve is not None}


def measure(model: Path) -> dict[str, Any]:
    """By solver: seconds, iterations and whether it missed the optimum, of each program; and its active bounds.

    An optimum is missed where the solver gives up, leaves the box, or where another one's cost is lower.
    """
    programs = recorded(model)
    solvers = BoxSolvers(len(programs[0].gradient), native_processor())
    programs = [program for program in programs if not solvers.free_optimum(program)[1]]
    every, rows, active = peers(len(programs[0].gradient)), dict[str, list[list[float]]](), list[int]()
    for program in programs:
        answers: dict[str, Answer] = {}
        for name, solve in every.items():
            with undisturbed():
                runs = [solve(program) for _ in range(RUNS if name in ("box_qp.h", "HPIPM") else 1)]
            answers[name] = min(runs, key=lambda run: run[0])
        optimum = answers["box_qp.h"][2]
        active.append(int(np.count_nonzero((optimum <= program.lower) | (optimum >= program.upper))))
        best = np.nanmin([cost_of(program, v) for _, _, v in answers.values()])
        for name, (seconds, iterations, v) in answers.items():
            missed = not cost_of(program, v) <= best + MAX_EXCESS * abs(best)
            rows.setdefault(name, []).append([seconds, iterations, missed])
    return {"rows": rows, "active": active}


def cost_of(program: BoxProgram, v: np.ndarray) -> float:
    """The cost at v (n,), moved into the box where rounding leaves it; NaN outside of it."""
    room = 1e-6 * (program.upper - program.lower)
    inside = bool(np.all((v >= program.lower - room) & (v <= program.upper + room)))
    return program.cost(np.clip(v, program.lower, program.upper)) if inside else float("nan")


def with_each_blasfeo(folder: Path) -> dict[str, Any]:
    """The last line that `python -m benchmarks kernel box_qp --measure FOLDER` prints, as JSON, by HPIPM's BLASFEO."""
    builds: dict[str, dict[str, str]] = {"CasADi's (generic)": {}}
    if faster := list(ACADOS.glob("*/*/acados/install")):
        builds["acados' (Haswell)"] = {"ALULA_HPIPM": str(faster[0])}
    timings = {}
    for build, environment in builds.items():
        command = own_command("kernel", "box_qp", "--measure", str(folder))
        done = subprocess.run(command, env=os.environ | environment, stdout=subprocess.PIPE, text=True, check=True)
        timings[build] = json.loads(done.stdout.splitlines()[-1])
    return timings


def table(builds: dict[str, dict[str, Any]]) -> str:
    lines = ["| solver | us, median | p99 | worst | iterations, median | worst | unsolved |", "| --- " * 7 + "|"]
    for build, measured in builds.items():
        for name, rows in measured["rows"].items():
            if name != "HPIPM" and build != next(iter(builds)):
                continue  # BLASFEO is HPIPM's alone
            seconds, iterations, missed = np.array(rows).T
            marks = " | ".join(f"{1e6 * np.percentile(seconds, share):.0f}" for share in (50, 99, 100))
            label = f"{name}, BLASFEO {build}" if name == "HPIPM" else name
            lines.append(
                f"| {label} | {marks} | {np.median(iterations):.0f} | {iterations.max():.0f} | "
                f"{np.count_nonzero(missed)} of {missed.size} |"
            )
    active = np.array(next(iter(builds.values()))["active"])
    text = f"Active bounds: {np.median(active):.0f} in the median, {active.max():.0f} at most, of programs with any."
    if not any("DAQP" in line for line in lines):
        text += " DAQP was not installed (pip install daqp)."
    return "\n".join([*lines, "", text])


def box_qp(words: Sequence[str]) -> Page | None:
    """The measurement's page."""
    parser = options_of(__doc__)
    parser.add_argument("--model", type=Path, default=FOLDER / "arpl_250g.pi_tcn.pt", help="checkpoint that flies")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args(words)
    if arguments.measure is not None:
        print(json.dumps(measure(arguments.measure)))
        return None
    return Page(
        "box_qp",
        "Quadratic programs of saturated flight, one core",
        table(with_each_blasfeo(arguments.model)),
    )
