"""The quadratic programs of saturated flight, solved by box_qp.h and by HPIPM.

PI-TCN follows a lemniscate whose reference leaps every 0.3 s by up to 0.6 m, in lockstep. Every program whose optimum
lies on bounds is kept, and solved by both with the tolerance that flies, in turns on one core; each time is the least
of three. HPIPM's time depends on its BLASFEO: CasADi's generic one is what a default install has.

    python -m benchmarks.box_qp [--networks build/rti_network]      a minute
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from benchmarks.provenance import write_result
from benchmarks.rti_flight import NETWORKS, PERIODS, fly, networks, solver_for, undisturbed, with_each_blasfeo
from export.trained import read_model
from fixtures.box_programs import BoxProgram, BoxSolvers
from runtime.control.rti.problem import Problem, fill_options
from runtime.control.rti.processor import native_processor
from runtime.control.rti.solver import RtiSolver

LEAP = 0.6  # m


def recorded(networks_folder: Path) -> list[BoxProgram]:
    """The program of every tick, at the state that its preparation expected."""
    solver = solver_for(read_model(networks_folder / "pi_tcn.pt"), native_processor())
    options, boxes = fill_options(solver.problem, solver.model), list[BoxProgram]()
    lower, upper = (np.tile(list(bound), solver.problem.nodes) for bound in (options.u_lower, options.u_upper))

    def keep(caller: RtiSolver, state: np.ndarray) -> None:
        assert caller.prepare(caller.model.initial_state(state)) == 0
        room = [(bound - caller.inputs.ravel()) / options.scale for bound in (lower, upper)]
        boxes.append(BoxProgram(caller.hessian.copy(), caller.gradient.copy(), *room))

    fly(solver, PERIODS["5.1"], jumps=LEAP, watch=keep)
    return boxes


def measure(folder: Path) -> list[list[float]]:
    """Rows of a program's: bounds that act; then seconds, iterations and status of box_qp.h, and the same of HPIPM."""
    programs, problem = recorded(folder), Problem()
    solvers, rows = BoxSolvers(len(programs[0].gradient), native_processor()), []
    for program in programs:
        if solvers.free_optimum(program)[1]:
            continue
        row: list[float] = []
        for by in ("box_qp", "hpipm"):
            with undisturbed():
                runs = [
                    solvers.solve(program, tolerance=problem.tolerance, max_iterations=problem.iterations, by=by)
                    for _ in range(3)
                ]
            if not row:
                row.append(int(np.count_nonzero((runs[0].v <= program.lower) | (runs[0].v >= program.upper))))
            row += [min(run.seconds for run in runs), runs[0].iterations, runs[0].status]
        rows.append(row)
    return rows


def table(boxes: dict[str, list[list[float]]]) -> str:
    lines = [
        "| solver, BLASFEO | us, median | p99 | worst | iterations, median | worst | unsolved |",
        "| --- " * 7 + "|",
    ]
    for build, rows in boxes.items():
        acting, *columns = np.array(rows).T
        for name, (seconds, iterations, status) in zip(("box_qp.h", "HPIPM"), (columns[:3], columns[3:]), strict=True):
            marks = " | ".join(f"{1e6 * np.percentile(seconds, share):.0f}" for share in (50, 99, 100))
            lines.append(
                f"| {name}, {build} | {marks} | {np.median(iterations):.0f} | {iterations.max():.0f} | "
                f"{np.count_nonzero(status)} of {status.size} |"
            )
    return "\n".join(
        [*lines, "", f"Bounds that act: {np.median(acting):.0f} in the median, {acting.max():.0f} at most."]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--networks", type=Path, default=NETWORKS)
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure is not None:
        print(json.dumps(measure(arguments.measure)))
        return
    boxes = with_each_blasfeo("benchmarks.box_qp", networks(arguments.networks))
    write_result("box_qp", "Quadratic programs of saturated flight, one core", table(boxes))


if __name__ == "__main__":
    main()
