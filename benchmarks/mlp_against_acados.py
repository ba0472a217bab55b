"""The learned models' RTI step against acados' SQP_RTI with the multilayer perceptron, T = 1, one core.

The paper's closed loop flew an MLP without history, because the network with history took too long. Here the kernel's
step of PI-TCN (T = 20, exact history derivatives) and of the MLP stand beside acados' step with that same MLP (RK4 over
a node, its derivatives by CasADi as MX, which is acados' faster way): same problem, same recorded states of a
lemniscate at 5.1 m/s, same run, in turns of fifty ticks on the same core.

    python -m benchmarks.mlp_against_acados [--networks build/rti_network]      two minutes, five where it has to train

With `--ticks` it is a trial that writes no page: fewer ticks, by networks that were hardly trained.
"""

from __future__ import annotations

import argparse
import json
import pickle
import sys
from pathlib import Path

import numpy as np

from benchmarks.provenance import write_result
from benchmarks.rti_against_acados import (
    CONDENSING,
    Worker,
    acados_environment,
    acados_worker,
    answer,
    problem_numbers,
    take_turns,
)
from benchmarks.rti_flight import NETWORKS, PERIODS, ROOT, fly, networks, solver_for
from export.trained import read_model
from runtime.control.rti.processor import native_processor
from runtime.control.rti.solver import RtiSolver

TRIAL, TRIAL_STEPS = NETWORKS.with_name("rti_network_trial"), 300


def record_cases(networks_folder: Path, folder: Path) -> tuple[Path, Path, int]:
    """Fly PI-TCN and record the inputs of every tick; acados' problem; the number of ticks."""
    model, mlp = (read_model(networks_folder / f"{kind}.pt") for kind in ("pi_tcn", "pi_mlp"))
    solver = solver_for(model, native_processor())
    cases: dict[str, list] = {"state": [], "state_reference": [], "input_reference": [], "history": []}

    def keep(caller: RtiSolver, state: np.ndarray) -> None:
        values = (state, caller.state_reference, caller.input_reference, caller.history)
        for name, value in zip(cases, values, strict=True):
            cases[name].append(value.copy())

    error, _, _ = fly(solver, PERIODS["5.1"], watch=keep)
    assert np.isfinite(error), "the flight to record crashed"
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "cases.npz", hover_speed=model.vehicle.hover_speed, **cases)
    (folder / "mlp.pickle").write_bytes(pickle.dumps(mlp.network))
    numbers = problem_numbers(solver) | {"rate_limits": [], "network": str(folder / "mlp.pickle")}
    (folder / "problem.json").write_text(json.dumps(numbers))
    return folder / "cases.npz", folder / "problem.json", len(cases["state"])


def table(workers: list[Worker]) -> str:
    steps = {}
    for worker in workers:
        steps[worker.name] = 1e6 * (np.array(worker.answers["prepare"]) + np.array(worker.answers["feedback"]))
    fastest = min(float(np.median(step)) for name, step in steps.items() if "acados SQP_RTI" in name)
    rows = ["| solver | step us, median | p99 | worst | unsolved | acados' faster MLP step over it |"]
    rows.append("| --- " * 6 + "|")
    for worker in workers:
        step, unsolved = steps[worker.name], np.count_nonzero(worker.answers["status"])
        rows.append(
            f"| {worker.name} | {np.median(step):.0f} | {np.percentile(step, 99):.0f} | {step.max():.0f} | "
            f"{unsolved} of {step.size} | {fastest / np.median(step):.1f} |"
        )
    first, last = (np.array(workers[i].answers["inputs"]) for i in (1, -1))
    rows += [
        "",
        f"First inputs of the kernel's MLP and of acados' differ by {np.median(np.abs(first - last)):.2g} "
        "rad/s in the median: the kernel's substeps hold the network's mean accelerations over 10 ms, acados' RK4 "
        "takes them as instantaneous.",
    ]
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--networks", type=Path, default=NETWORKS)
    parser.add_argument("--ticks", type=int)
    parser.add_argument("--own-worker", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.own_worker:
        answer(solver_for(read_model(arguments.own_worker), native_processor()))
        return
    trial = arguments.ticks is not None
    checkpoints = networks(TRIAL, TRIAL_STEPS) if trial else networks(arguments.networks)
    install, folder = acados_environment(), ROOT / "build" / "mlp_against_acados"
    cases, problem, ticks = record_cases(checkpoints, folder)
    processor, workers = native_processor().name, []
    for build, environment in (("acados' (Haswell)", {"ALULA_HPIPM": str(install)}), ("CasADi's (generic)", {})):
        for kind, name in (("pi_tcn", "PI-TCN, T = 20"), ("pi_mlp", "MLP, T = 1")):
            command = [sys.executable, "-m", "benchmarks.mlp_against_acados"]
            command += ["--own-worker", str(checkpoints / f"{kind}.pt")]
            workers.append(Worker(f"Alula, {name}, {processor}, BLASFEO {build}", command, **environment))
    for condensing in CONDENSING:
        name = f"acados SQP_RTI, MLP, T = 1, {condensing}"
        workers.append(acados_worker(name, install, problem, condensing, folder / condensing.lower()))
    take_turns(workers, cases, min(ticks, arguments.ticks) if trial else ticks)
    if trial:
        print(table(workers))
        return
    write_result("mlp_against_acados", "Learned models' RTI step against acados with the MLP, one core", table(workers))


if __name__ == "__main__":
    main()
