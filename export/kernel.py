"""The real-time kernel of a network: its sources gathered, compiled for a processor, loaded as a solver."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

from dynamics.codegen import build_library, generate_c
from dynamics.errors import RequestError
from dynamics.model import ENVIRONMENT_DEFAULT, Model
from export.kernel_source import network_header
from export.network import Ensemble, Network
from export.physics import NAME, depends_on_position, physics_function
from export.reverse_split import ReverseSplit, cheapest_split
from runtime.control.rti.compilation import SHARED
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import Processor
from runtime.control.rti.solver import RtiSolver
from runtime.control.rti.state_header import STATE_HEADER, state_header

Precision = Literal["float", "double"]
SOURCES = (
    "network.c",
    "reverse_split.h",
    "tangents.h",
    "layers.h",
    "ensemble.h",
    "kinematics.h",
    *SHARED,
)
ENTRY = "network.c"


@dataclass(frozen=True)
class KernelRecipe:
    """Input of the compiler for a kernel.

    sources: text by file name.
    flags: the compiler's.
    entry: name of the source file that is compiled.
    """

    sources: dict[str, str]
    flags: tuple[str, ...]
    entry: str = ENTRY


def kernel_recipe(
    network: Network,
    model: Model,
    problem: Problem,
    processor: Processor,
    precision: Precision = "float",
    *,
    mean: bool = True,
    extrapolated: bool = False,
    split: ReverseSplit | None = None,
    ensemble: Ensemble | None = None,
) -> KernelRecipe:
    """Sources and flags of a network's kernel. model: the vehicle's, with the effects of a residual's base.

    mean: a residual is added to the physics' mean accelerations over a step, else to those at its beginning.
    extrapolated: accelerations are extrapolated by half a step along their slope, else held over it.
    split: layers that propagate tangents and layers differentiated backwards, by default the cheapest.
    ensemble: the members that do not fly.

    Raises RequestError when a node is no whole number of the network's steps.
    """
    steps = [round(interval / network.dt) for interval in problem.intervals]
    for count, interval in zip(steps, problem.intervals, strict=True):
        if count < 1 or abs(count * network.dt - interval) > 1e-9:
            raise RequestError(
                f"nodes of {1e3 * interval:g} ms are no whole number of the network's steps of "
                f"{1e3 * network.dt:g} ms; change the horizon, the number of nodes or their growth."
            )
    folder = resources.files("runtime.control.rti")
    sources = {name: folder.joinpath(name).read_text() for name in SOURCES} | {STATE_HEADER: state_header()}
    sources["network.h"] = network_header(
        network, split or cheapest_split(network, problem.nodes), extrapolated=extrapolated, ensemble=ensemble
    )
    defines: dict[str, int | str] = {
        "NX": model.state_count, "NU": model.input_count, "NODES": problem.nodes,
        "NP": model.parameter_values.size, "NE": ENVIRONMENT_DEFAULT.size,
        "STEPS": sum(steps), "VECTOR_BYTES": processor.vector, "FREE": 3,
        "NETWORK_REAL": precision, "NETWORK_INTEGER": "int" if precision == "float" else "long",
    }  # fmt: skip
    if network.residual:
        physics = physics_function(model, dt=network.dt, mean=mean)
        sources["physics.c"] = generate_c([physics])
        defines |= {
            "PHYSICS": NAME,
            "PHYSICS_ARG": physics.sz_arg(),
            "PHYSICS_RES": physics.sz_res(),
            "PHYSICS_IW": physics.sz_iw(),
            "PHYSICS_W": physics.sz_w(),
            "FREE": 0 if depends_on_position(physics) else 3,
        }
    elif model.hidden_count:
        raise RequestError(
            "a network that replaces the model has no use for effects with hidden states; leave them out."
        )
    return KernelRecipe(sources, (*processor.compiler_flags, *(f"-D{name}={value}" for name, value in defines.items())))


def build_kernel(recipe: KernelRecipe, compiler: str | None = None) -> Path:
    """Path of the compiled kernel. compiler: this machine's by default. Raises RequestError without one."""
    return build_library(recipe.sources, flags=recipe.flags, entry=recipe.entry, compiler=compiler)


def kernel_solver(
    network: Network,
    model: Model,
    problem: Problem,
    processor: Processor,
    precision: Precision = "float",
    *,
    mean: bool = True,
    ensemble: Ensemble | None = None,
) -> RtiSolver:
    """A solver on a freshly built kernel, as the runtime creates one from a bundle.

    mean: the network predicts mean accelerations, else instantaneous ones, which are extrapolated.
    ensemble: the members that do not fly.
    """
    recipe = kernel_recipe(
        network, model, problem, processor, precision, mean=mean, extrapolated=not mean, ensemble=ensemble
    )
    return RtiSolver(model, problem, build_kernel(recipe))
