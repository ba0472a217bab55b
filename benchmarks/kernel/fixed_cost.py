"""Tangents of a network's kernel that do not depend on the number of columns, by leaving parts out.

The bundled PI-TCN with 20 nodes in 1 s, on a Lemniscate. Each row is the same kernel, compiled without a part, so that
its result is wrong and its time shows the part's. One column: every row of tangents is one vector long, which leaves
what does not depend on the number of columns.

    python -m benchmarks kernel fixed_cost [--rounds 600]
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.measurement import Page, options_of, paragraph_of
from dynamics.references import named_reference
from export.kernel import KernelRecipe, build_kernel, kernel_recipe
from export.trained import ExportedModel, read_model
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import native_processor
from runtime.control.rti.solver import RtiSolver
from vehicles import FOLDER

Change = tuple[str, str, str]
ONE_COLUMN: Change = (
    "tangents.h", "return PAD(BY_INPUT + NU * (node + 1)); }", "(void)node; return LANES; }"
)  # fmt: skip
WITHOUT: Mapping[str, Change] = {
    "reverse sweep of the layers behind the streamed ones": (
        "tangents.h", "*by_code = sweep(r, s);", "*by_code = r->tangents.perceptron;"
    ),
    "streamed layers": ("tangents.h", "        EACH_STREAMED(STREAM_LAYER)\n", ""),
    "packing of the streamed layers' weights": (
        "tangents.h",
        "pack(outputs, W + (tap * inputs + i) * outputs, mine, packed[count]);\n"
        "            weights[count] = packed[count], count++;",
        "weights[count] = W + (tap * inputs + i) * outputs, count++;",
    ),
    "masks of the ReLUs": (
        "tangents.h", "    find_masks(r);\n", "    static int once; if (!once) find_masks(r), once = 1;\n"
    ),
}  # fmt: skip


def fixed_cost(words: Sequence[str]) -> Page:
    """The measurement's page."""
    parser = options_of(__doc__, rounds=600)
    chosen = parser.parse_args(words)
    model = read_model(FOLDER / "arpl_250g.pi_tcn.pt")
    kernels: dict[str, tuple[Change, ...]] = {"all": (), "one column": (ONE_COLUMN,)}
    kernels |= {f"one column, without: {part}": (ONE_COLUMN, change) for part, change in WITHOUT.items()}
    recipe = recipe_of(model)
    solvers = {name: RtiSolver(model.flight_model, Problem(), build(recipe, some)) for name, some in kernels.items()}
    times = {name: np.array(values) for name, values in tangent_times(model, solvers, chosen.rounds).items()}
    base = float(times["one column"].min())
    rows = ["kernel | tangents, us: least | 10 % | less than one column, us", "--- | --- | --- | ---"]
    for name, values in times.items():
        less = f"{base - values.min():.0f}" if "without" in name else ""
        rows.append(f"{name} | {values.min():.0f} | {np.percentile(values, 10):.0f} | {less}")
    table = "\n".join(f"| {row} |" for row in rows)
    return Page(
        "fixed_cost", "What tangents cost whatever the number of columns", f"{paragraph_of(__doc__)}\n\n{table}"
    )


def recipe_of(model: ExportedModel) -> KernelRecipe:
    """Sources of the kernel as it is exported."""
    assert model.network is not None
    return kernel_recipe(
        model.network,
        model.flight_model,
        Problem(),
        native_processor(),
        mean=model.mean,
        extrapolated=model.extrapolated,
        ensemble=model.ensemble,
    )


def build(recipe: KernelRecipe, edits: Sequence[Change]) -> Path:
    """The kernel with edits of its sources: file, text, other text."""
    sources = dict(recipe.sources)
    for file, before, after in edits:
        assert before in sources[file], (file, before)
        sources[file] = sources[file].replace(before, after)
    return build_kernel(dataclasses.replace(recipe, sources=sources))


def tangent_times(model: ExportedModel, solvers: Mapping[str, RtiSolver], rounds: int) -> dict[str, list[float]]:
    """Times of each preparation's tangents, us, the kernels one after the other in each round."""
    reference, problem = named_reference("Lemniscate", model.vehicle), Problem()
    instants = 4.0 + problem.node * np.arange(problem.nodes + 1)
    states, inputs = reference.states(instants), reference.inputs(instants)[:-1]
    times: dict[str, list[float]] = {name: [] for name in solvers}
    for solver in solvers.values():
        solver.history[:] = np.append(states[0], inputs[0])
        solver.state_reference[:, : states.shape[1]], solver.input_reference[:] = states, inputs
    for _ in range(rounds):
        for name, solver in solvers.items():
            start = np.zeros(solver.states.shape[1])
            start[: states.shape[1]] = states[0]
            solver.inputs[:] = inputs
            solver.prepare(start)
            times[name].append(1e6 * solver.report.tangent_seconds)
    return times
