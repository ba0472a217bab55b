"""The kernel for the computers that ride on vehicles gives there what it gives here: run by an emulator, QEMU."""

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from dynamics.arrays import Floats
from dynamics.model import Model, build_model
from dynamics.vehicle import Vehicle
from export.kernel import kernel_recipe, kernel_solver
from export.network import Network
from runtime.control.rti.problem import Problem, fill_options
from runtime.control.rti.processor import PROCESSORS, native_processor
from runtime.control.rti.solver import RtiSolver
from tests.support.networks import random_network

COMPILER, EMULATOR = shutil.which("aarch64-linux-gnu-gcc"), shutil.which("qemu-aarch64")
PROGRAM = Path(__file__).parents[1] / "support" / "kernel_program.c"
PROBLEM = Problem(nodes=10, horizon=0.5)


@dataclass(frozen=True)
class Case:
    """Arguments of a kernel at a tick, and its answers: states, Hessian and gradient, then the new inputs."""

    arguments: tuple[Floats, ...]
    answers: tuple[Floats, ...]
    acting: bool


def recorded_cases(solver: RtiSolver, ticks: tuple[int, ...]) -> list[Case]:
    """A flight from hover towards a place two metres away, in the model itself."""
    model, speed = solver.model, solver.model.vehicle.hover_speed
    state = model.initial_state(np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6]))
    solver.reset(state)
    solver.state_reference[:] = state
    solver.state_reference[:, 0] = 2.0
    solver.input_reference[:] = speed
    solver.history[:] = np.concatenate([state[:13], np.full(model.input_count, speed)])
    cases = []
    for tick in range(ticks[-1] + 1):
        arguments = [value.copy() for value in (solver.parameters, solver.environment, solver.history, state)]
        arguments += [value.copy() for value in (solver.inputs, solver.state_reference, solver.input_reference)]
        assert solver.prepare(state) == 0
        prepared = [value.copy() for value in (solver.states, solver.hessian, solver.gradient)]
        assert solver.feedback(state) == 0
        if tick in ticks:
            cases.append(Case(tuple(arguments), (*prepared, solver.inputs.copy()), solver.report.iterations > 0))
        column = np.concatenate([state[:13], solver.inputs[0]])
        after = solver.propagate(state, solver.inputs[0], 0.01).copy()
        solver.history[:] = np.vstack([solver.history[1:], column])
        state = after
    return cases


def build_program(network: Network, model: Model, folder: Path) -> Path:
    """The kernel as a program of its own."""
    recipe = kernel_recipe(network, model, PROBLEM, PROCESSORS["neon"])
    for name, text in recipe.sources.items():
        (folder / name).write_text(text)
    (folder / "program.c").write_text(PROGRAM.read_text())
    flags = [flag for flag in recipe.flags if flag not in ("-shared", "-fPIC")]
    assert COMPILER is not None
    command = [COMPILER, *flags, "-static", "program.c", "-lm", "-o", "program"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "program"


def answers_of(program: Path, model: Model, case: Case) -> tuple[Floats, ...]:
    """What the program answers in the emulator."""
    assert EMULATOR is not None
    stdin = bytes(fill_options(PROBLEM, model)) + b"".join(
        np.ascontiguousarray(part).tobytes() for part in case.arguments
    )
    done = subprocess.run([EMULATOR, str(program)], input=stdin, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    values, ends = np.frombuffer(done.stdout), np.cumsum([part.size for part in case.answers])
    parts = np.split(values, ends[:-1])
    return tuple(part.reshape(expected.shape) for part, expected in zip(parts, case.answers, strict=True))


@pytest.mark.long("compiles for another processor, and emulates it")
@pytest.mark.skipif(COMPILER is None, reason="no aarch64-linux-gnu-gcc; Debian: gcc-aarch64-linux-gnu")
@pytest.mark.skipif(EMULATOR is None, reason="no qemu-aarch64; Debian: qemu-user")
def test_the_kernel_answers_on_aarch64_as_the_double_one_does_here(tmp_path: Path, arpl_250g: Vehicle) -> None:
    network, model = random_network(residual=True), build_model(arpl_250g, effects=[])
    cases = recorded_cases(kernel_solver(network, model, PROBLEM, native_processor(), "double"), (0, 3, 20, 90))
    assert {case.acting for case in cases} == {True, False}
    program = build_program(network, model, tmp_path)
    for case in cases:
        states, hessian, gradient, inputs = answers_of(program, model, case)
        np.testing.assert_allclose(states, case.answers[0], rtol=0, atol=2e-5)
        np.testing.assert_allclose(hessian, case.answers[1], rtol=0, atol=2e-4 * np.abs(case.answers[1]).max())
        np.testing.assert_allclose(gradient, case.answers[2], rtol=0, atol=2e-4 * np.abs(case.answers[2]).max())
        np.testing.assert_allclose(inputs, case.answers[3], rtol=0, atol=1e-3 * arpl_250g.hover_speed)
