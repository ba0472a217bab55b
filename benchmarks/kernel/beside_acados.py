"""Alula's RTI steps beside acados' SQP_RTI: same problem, same states, same run, one core.

Not named after acados: the worker has this folder on its path, and imports acados.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import subprocess
import sys
import tomllib
import venv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.kernel.flight import NETWORKS, PERIODS, fly, networks, solver_for
from benchmarks.measurement import ROOT, Page, options_of, own_command
from dynamics.model import build_model
from dynamics.references import named_reference
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from export.trained import read_model
from runtime.control.rti.problem import Problem, fill_options
from runtime.control.rti.processor import native_processor
from runtime.control.rti.solver import RtiSolver

ENVIRONMENT = ROOT / ".venv-acados"
CONDENSING = ("PARTIAL_CONDENSING_HPIPM", "FULL_CONDENSING_HPIPM")
CHUNK = 50
TICKS = 600
ITERATIONS = 50  # of acados' QP at most, which begins at the measured state: ours goes on from a prepared point


def install_acados() -> None:
    """Make acados' own environment, anew when what the project needs has changed.

    Raises subprocess.CalledProcessError where pip cannot install it.
    """
    python, made_for = ENVIRONMENT / "bin" / "python", ENVIRONMENT / "packages"
    packages = "\n".join(["comma-deps-acados", *base_packages()])
    if not made_for.exists() or made_for.read_text(encoding="utf-8") != packages:
        venv.create(ENVIRONMENT, with_pip=True, clear=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *packages.splitlines()], check=True)
        made_for.write_text(packages, encoding="utf-8")


def acados_environment() -> Path:
    """acados' install folder, in an environment of its own."""
    install_acados()
    code = "import acados, os; print(os.path.dirname(acados.__file__))"
    python = ENVIRONMENT / "bin" / "python"
    acados_folder = subprocess.run([python, "-c", code], check=True, capture_output=True, text=True).stdout.strip()
    return Path(acados_folder) / "install"


def base_packages() -> list[str]:
    """Packages of the base install, by which a vehicle file is read; CasADi is the one that acados brings."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return list(project["dependencies"])


def record_cases(folder: Path) -> tuple[Path, Path]:
    """Fly the manoeuvre in a plain simulation and record the inputs of the solver at every tick."""
    vehicle = read_vehicle(ROOT / "vehicles" / "arpl_250g.toml")
    model = build_model(vehicle)
    problem = Problem()
    solver = RtiSolver(model, problem)
    plant = RtiSolver(build_model(vehicle, effects=[EffectUse("motor_lag"), EffectUse("rotor_drag")]), problem)
    reference = named_reference("Lemniscate", vehicle)
    offsets = problem.node * np.arange(problem.nodes + 1)
    truth = plant.model.initial_state(reference.states(np.array([0.0]))[0])
    solver.reset(truth[:13])
    cases: dict[str, list] = {"state": [], "state_reference": [], "input_reference": []}
    for tick in range(TICKS):
        times = 0.01 * tick + offsets
        states = reference.states(times)
        states *= np.where(states[:1, 6:10] @ truth[6:10] < 0, [1] * 6 + [-1] * 4 + [1] * 3, 1)
        solver.state_reference[:], solver.input_reference[:] = states, reference.inputs(times[:-1])
        for name, value in zip(cases, (truth[:13], states, reference.inputs(times[:-1])), strict=True):
            cases[name].append(value.copy())
        solver.prepare(truth[:13])
        solver.feedback(truth[:13])
        truth = plant.propagate(truth, solver.inputs[0], 0.01).copy()
    numbers = problem_numbers(solver) | {"rate_limits": list(vehicle.limits.rate)}
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "cases.npz", hover_speed=vehicle.hover_speed, **cases)
    (folder / "problem.json").write_text(json.dumps(numbers))
    return folder / "cases.npz", folder / "problem.json"


def problem_numbers(solver: RtiSolver) -> dict[str, object]:
    """A solver's problem for acados."""
    problem, options = solver.problem, fill_options(solver.problem, solver.model)
    numbers: dict[str, object] = {n: list(getattr(options, n)) for n in ("Q", "P", "R", "u_lower", "u_upper")}
    numbers |= {name: getattr(problem, name) for name in ("nodes", "horizon", "levenberg_marquardt")}
    numbers |= {"tolerance": problem.tolerance, "soft_penalty": problem.soft_penalty, "iterations": ITERATIONS}
    return numbers | {"integrator": "ERK"}


class Worker:
    """A solver in a process of its own that answers chunks of ticks."""

    def __init__(self, name: str, command: list[str], **environment: str) -> None:
        self.name = name
        variables = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", **environment}
        self._process = subprocess.Popen(
            ["taskset", "-c", "0", *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=variables
        )
        self.answers: dict[str, list] = {"prepare": [], "feedback": [], "inputs": [], "status": []}
        if "ready" not in self._process.stdout.readline():
            raise SystemExit(f"{name} did not start")

    def ask(self, cases: Path, first: int, last: int) -> None:
        print(json.dumps({"cases": str(cases), "first": first, "last": last}), file=self._process.stdin, flush=True)
        for key, values in json.loads(self._process.stdout.readline()).items():
            self.answers[key] += values

    def close(self) -> None:
        self._process.stdin.close()
        self._process.wait()


def answer(solver: RtiSolver) -> None:
    """Our solver behind the same two-line protocol as acados'."""
    print(json.dumps({"ready": True}), flush=True)
    cases = None
    for line in sys.stdin:
        request = json.loads(line)
        if cases is None:
            cases = dict(np.load(request["cases"]))
            solver.reset(cases["state"][0])
        answers: dict[str, list] = {"prepare": [], "feedback": [], "inputs": [], "status": []}
        for tick in range(request["first"], request["last"]):
            solver.state_reference[:] = cases["state_reference"][tick]
            solver.input_reference[:] = cases["input_reference"][tick]
            if columns := len(solver.history):
                solver.history[:] = cases["history"][tick, -columns:]
            solver.prepare(cases["state"][tick])
            answers["status"].append(solver.feedback(cases["state"][tick]))
            answers["prepare"].append(solver.report.prepare_seconds)
            answers["feedback"].append(solver.report.feedback_seconds)
            answers["inputs"].append(solver.inputs[0].tolist())
        print(json.dumps(answers), flush=True)


def acados_worker(name: str, install: Path, problem: Path, condensing: str, folder: Path) -> Worker:
    """acados' solver of a problem, generated and built in a folder."""
    python, script = str(ENVIRONMENT / "bin" / "python"), str(Path(__file__).with_name("acados_worker.py"))
    vehicle = str(ROOT / "vehicles" / "arpl_250g.toml")
    paths = {"PYTHONPATH": str(ROOT), "ACADOS_SOURCE_DIR": str(install)}
    paths["ACADOS_PYTHON_INTERFACE_PATH"] = str(install.parent / "acados_template")
    paths |= {"LD_LIBRARY_PATH": str(install / "lib"), "TERA_PATH": str(install / "bin" / "t_renderer")}
    return Worker(name, [python, script, vehicle, str(problem), condensing, str(folder)], **paths)


def take_turns(workers: list[Worker], cases: Path, ticks: int) -> None:
    """Let every worker answer all ticks, fifty at a time in turns."""
    for first in range(0, ticks, CHUNK):
        for worker in workers:
            worker.ask(cases, first, min(first + CHUNK, ticks))
    for worker in workers:
        worker.close()


def table(workers: list[Worker]) -> str:
    rows = ["| solver | preparation us | feedback us | step us, median | p99 | unsolved |", "| --- " * 6 + "|"]
    medians = {}
    for worker in workers:
        prepare, feedback = (1e6 * np.array(worker.answers[key]) for key in ("prepare", "feedback"))
        step = prepare + feedback
        medians[worker.name] = float(np.median(step))
        unsolved = int(np.count_nonzero(worker.answers["status"]))
        rows.append(
            f"| {worker.name} | {np.median(prepare):.0f} | {np.median(feedback):.0f} | {np.median(step):.0f} | "
            f"{np.percentile(step, 99):.0f} | {unsolved} of {step.size} |"
        )
    first = np.array(workers[0].answers["inputs"])
    notes = []
    for worker in workers[1:]:
        gap = np.abs(np.array(worker.answers["inputs"]) - first)
        ratio = medians[worker.name] / medians[workers[0].name]
        notes.append(
            f"- {worker.name}: first inputs differ from the first row by {np.median(gap):.2g} rad/s in the median, "
            f"{gap.max():.2g} at most; its median step takes {ratio:.2f} times as long."
        )
    return "\n".join([*rows, "", *notes])


def nominal(words: Sequence[str]) -> Page | None:
    """The nominal RTI step against acados' SQP_RTI: same problem, same states, same run, one core.

    Both solvers answer the same recorded sequence of states (a flight of the paper's Lemniscate on a plant with motor
    lag and rotor drag) in turns of fifty ticks, each pinned to the same core and free to use one thread. acados comes
    from PyPI's comma-deps-acados in an environment of its own, because it brings a casadi of its own.

        python -m benchmarks kernel acados [--ticks 600]
    """
    parser = options_of(nominal.__doc__)
    parser.add_argument("--own-worker", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--ticks", type=int, default=TICKS, help="fewer for a trial, which writes no page")
    parser.add_argument("--own-side", action="store_true", help="a trial without acados, of what is ours")
    arguments = parser.parse_args(words)
    if arguments.own_worker:
        answer(RtiSolver(build_model(read_vehicle(ROOT / "vehicles" / "arpl_250g.toml")), Problem()))
        return None
    folder = ROOT / "build" / "rti_against_acados"
    cases, problem = record_cases(folder)
    own = own_command("kernel", "acados", "--own-worker")
    workers = [Worker("Alula", own)]
    if not arguments.own_side:
        install = acados_environment()
        for condensing in CONDENSING:
            name, build = f"acados SQP_RTI, {condensing}", folder / condensing.lower()
            workers.append(acados_worker(name, install, problem, condensing, build))
    take_turns(workers, cases, arguments.ticks)
    title = "Nominal RTI step against acados, one core"
    return Page("rti_against_acados", title, table(workers), trial=arguments.own_side or arguments.ticks < TICKS)


TRIAL, TRIAL_STEPS = NETWORKS.with_name("rti_network_trial"), 300


def learned_record_cases(networks_folder: Path, folder: Path) -> tuple[Path, Path, int]:
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


def learned_table(workers: list[Worker]) -> str:
    steps = {}
    for worker in workers:
        steps[worker.name] = 1e6 * (np.array(worker.answers["prepare"]) + np.array(worker.answers["feedback"]))
    fastest = min((float(np.median(step)) for name, step in steps.items() if "acados SQP_RTI" in name), default=np.nan)
    rows = ["| solver | step us, median | p99 | worst | unsolved | acados' faster MLP step over it |"]
    rows.append("| --- " * 6 + "|")
    for worker in workers:
        step, unsolved = steps[worker.name], np.count_nonzero(worker.answers["status"])
        rows.append(
            f"| {worker.name} | {np.median(step):.0f} | {np.percentile(step, 99):.0f} | {step.max():.0f} | "
            f"{unsolved} of {step.size} | {fastest / np.median(step):.1f} |"
        )
    if np.isnan(fastest):
        return "\n".join([*rows, "", "acados did not answer beside them."])
    first, last = (np.array(workers[i].answers["inputs"]) for i in (1, -1))
    rows += [
        "",
        f"First inputs of the kernel's MLP and of acados' differ by {np.median(np.abs(first - last)):.2g} "
        "rad/s in the median: the kernel's substeps hold the network's mean accelerations over 10 ms, acados' RK4 "
        "takes them as instantaneous.",
    ]
    return "\n".join(rows)


def learned(words: Sequence[str]) -> Page | None:
    """The learned models' RTI step against acados' SQP_RTI with the multilayer perceptron, T = 1, one core.

    The paper's closed loop flew an MLP without history, because the network with history took too long. Here the
    kernel's step of PI-TCN (T = 20, exact history derivatives) and of the MLP stand beside acados' step with that same
    MLP (RK4 over a node, its derivatives by CasADi as MX, which is acados' faster way): same problem, same recorded
    states of a lemniscate at 5.1 m/s, same run, in turns of fifty ticks on the same core.

        python -m benchmarks kernel acados_mlp [--networks build/rti_network]      two minutes, five where it has to
          train

    With `--ticks` it is a trial that writes no page: fewer ticks, by networks that were hardly trained.
    """
    parser = options_of(learned.__doc__)
    parser.add_argument("--networks", type=Path, default=NETWORKS)
    parser.add_argument("--ticks", type=int, help="of a trial, which writes no page")
    parser.add_argument("--own-side", action="store_true", help="a trial without acados, of what is ours")
    parser.add_argument("--own-worker", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args(words)
    if arguments.own_worker:
        answer(solver_for(read_model(arguments.own_worker), native_processor()))
        return None
    trial = arguments.own_side or arguments.ticks is not None
    checkpoints = networks(TRIAL, TRIAL_STEPS) if trial else networks(arguments.networks)
    folder = ROOT / "build" / "mlp_against_acados"
    cases, problem, ticks = learned_record_cases(checkpoints, folder)
    processor, workers = native_processor().name, []
    if not arguments.own_side:
        install = acados_environment()
    for kind, name in (("pi_tcn", "PI-TCN, T = 20"), ("pi_mlp", "MLP, T = 1")):
        command = own_command("kernel", "acados_mlp", "--own-worker", str(checkpoints / f"{kind}.pt"))
        workers.append(Worker(f"Alula, {name}, {processor}", command))
    for condensing in () if arguments.own_side else CONDENSING:
        name = f"acados SQP_RTI, MLP, T = 1, {condensing}"
        workers.append(acados_worker(name, install, problem, condensing, folder / condensing.lower()))
    take_turns(workers, cases, min(ticks, arguments.ticks or ticks))
    title = "Learned models' RTI step against acados with the MLP, one core"
    return Page("mlp_against_acados", title, learned_table(workers), trial=trial)
