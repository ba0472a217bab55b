"""Programs of the kernels' C with the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from dynamics.codegen import find_compiler, has_compiler
from dynamics.model import ENVIRONMENT_DEFAULT, Model, build_model
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import read_vehicle
from export.kernel import Precision, kernel_recipe
from runtime.control.adaptation_settings import AdaptationSettings
from runtime.control.flight_filter import FlightFilter
from runtime.control.followed_parameters import followed_parameters
from runtime.control.rti.compilation import solver_recipe
from runtime.control.rti.problem import Problem, fill_options
from runtime.control.rti.processor import native_processor
from runtime.control.rti.solver import RtiSolver
from tests.support.networks import random_network
from vehicles import FOLDER

HERE = Path(__file__).parent
# Undefined results of a conversion are outside of "undefined" by default; a division by zero has a result in IEEE 754.
FLAGS = ("-O0", "-g", "-fno-omit-frame-pointer", "-fsanitize=address,undefined,float-cast-overflow")
STRICT = ("-fno-sanitize-recover=all", "-w")
PROBLEM = Problem(nodes=5, horizon=0.25)
LAG_AND_DRAG = (EffectUse("motor_lag", {"time_constant": 0.03}), EffectUse("rotor_drag", {"coefficient": 2e-5}))


@cache
def why_not() -> str:
    """Why no program with sanitizers can be made and run here; empty where one can."""
    if not has_compiler():
        return "no C compiler"
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "empty.c").write_text("int main(void) { return 0; }")
        command = [find_compiler(), *FLAGS, *STRICT, "empty.c", "-o", "empty"]
        if subprocess.run(command, cwd=folder, capture_output=True, check=False).returncode != 0:
            return f"{find_compiler()} has no sanitizers"
        if subprocess.run([f"{folder}/empty"], capture_output=True, check=False).returncode != 0:
            return "programs with sanitizers do not run here"
    return ""


def solver_program(folder: Path, *effects: EffectUse, follow: Sequence[str] = ()) -> tuple[Path, bytes]:
    """The driver on the solver of the paper's quadrotor with effects, and what it reads."""
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml").with_effects(*effects)
    model = build_model(vehicle)
    sources, flags = solver_recipe(model, PROBLEM, native_processor())
    solver = RtiSolver(model, PROBLEM)
    FlightFilter(solver, AdaptationSettings(), followed_parameters(model, follow))
    return _program(folder, sources, flags, "rti.c", learned=False), _input(model, solver)


def network_program(folder: Path, *, precision: Precision, residual: bool) -> tuple[Path, bytes]:
    """The driver on the kernel of a random network, alone or with the physics of lag and drag below it."""
    network = random_network(channels=(5, 8), taps=2, dilations=(3, 1), hidden=(7,), residual=residual)
    model = build_model(read_vehicle(FOLDER / "arpl_250g.toml"), effects=LAG_AND_DRAG if residual else ())
    recipe = kernel_recipe(network, model, PROBLEM, native_processor(), precision)
    solver = RtiSolver(model, PROBLEM)  # whose options of the filter are those of any kernel
    FlightFilter(solver, AdaptationSettings())
    return _program(folder, recipe.sources, recipe.flags, recipe.entry, learned=True), _input(model, solver)


def run(program: Path, content: bytes, seed: int, calls: int) -> subprocess.CompletedProcess[bytes]:
    """Make so many calls; a fault of memory, or undefined behaviour, ends it with its report in stderr."""
    options = "abort_on_error=0:detect_leaks=1:allocator_may_return_null=0"
    environment = {**os.environ, "ASAN_OPTIONS": options, "UBSAN_OPTIONS": "print_stacktrace=1"}
    return subprocess.run(
        [program, str(seed), str(calls)], input=content, capture_output=True, env=environment, check=False, timeout=240
    )


def _program(folder: Path, sources: Mapping[str, str], flags: Sequence[str], entry: str, *, learned: bool) -> Path:
    for name, text in sources.items():
        (folder / name).write_text(text)
    shutil.copy(HERE / "kernel_driver.c", folder)
    others = [flag for flag in flags if not flag.startswith(("-O", "-shared", "-fPIC"))]
    defines = [f'-DKERNEL="{entry}"', f"-DLEARNED={int(learned)}"]
    return compiled(folder, "kernel_driver.c", (*others, *defines), ["-lm"])


def compiled(folder: Path, source: str, flags: Sequence[str], libraries: Sequence[str]) -> Path:
    """The program of a source file in a folder, with sanitizers."""
    command = [find_compiler(), *flags, *FLAGS, *STRICT, source, "-o", "program", *libraries]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder / "program"


def _input(model: Model, solver: RtiSolver) -> bytes:
    state = model.initial_state(np.array([0.0, 0.0, 1.0, *[0.0] * 3, 1.0, *[0.0] * 6]))
    options = bytes(fill_options(PROBLEM, model)) + bytes(solver.filter_options)
    numbers = (model.parameter_values, ENVIRONMENT_DEFAULT, state, np.broadcast_to(solver.trim.rotor_speed, (4,)))
    return options + b"".join(np.asarray(part, dtype=float).tobytes() for part in numbers)
