"""The solver of a model that RK4 integrates, compiled; needs CasADi and a C compiler."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Any

from dynamics import symbolic as ca
from dynamics.codegen import FLAGS, build_library, generate_c
from dynamics.effect import Expression
from dynamics.integrators import max_step, rk4, with_unit_attitude
from dynamics.model import ENVIRONMENT_DEFAULT, Model
from runtime.control.rti.problem import Problem
from runtime.control.rti.processor import Processor, native_processor
from runtime.control.rti.state_header import STATE_HEADER, state_header

ENTRY = "rti.c"
OWN = (ENTRY, "parameter_fit.h", "thrust_history.h")
SHARED = (
    "condensed.h",
    "box_qp.h",
    "box_factor.h",
    "flight_filter.h",
    "last_setpoint.h",
)  # with the kernel of a learned model


def build_solver(model: Model, problem: Problem) -> Path:
    """Path of the solver's library for a model's structure, compiled unless the cache holds it."""
    sources, flags = solver_recipe(model, problem, None)
    return build_library(sources, flags=flags, entry=ENTRY)


def solver_recipe(
    model: Model, problem: Problem, processor: Processor | None, field: ca.Function | None = None
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Sources by file name and compiler flags of the solver of a model that RK4 integrates.

    processor: None for this machine's own. field: (x, u, p, e) -> xdot and its derivatives by x and by u, of MX
    expressions (CasADi's C then has loops), instead of the model's own.
    """
    node, step = _functions(model, field or _field(model))
    longest = max_step(model.time_constants)
    defines: dict[str, int | str] = {
        "NX": model.state_count,
        "NU": model.input_count,
        "NODES": problem.nodes,
        "NP": model.parameter_values.size,
        "NE": ENVIRONMENT_DEFAULT.size,
        "MAX_STEP": repr(longest) if math.isfinite(longest) else "INFINITY",
        "VECTOR_BYTES": (processor or native_processor()).vector,
        "LOOPS": int(node.is_a("MXFunction")),
    }
    for name, function in (("NODE", node), ("STEP", step)):
        defines |= {
            name: function.name(),
            f"{name}_ARG": function.sz_arg(),
            f"{name}_RES": function.sz_res(),
            f"{name}_IW": function.sz_iw(),
            f"{name}_W": function.sz_w(),
        }
    folder = resources.files("runtime.control.rti")
    sources = {name: folder.joinpath(name).read_text() for name in (*OWN, *SHARED)}
    sources[STATE_HEADER] = state_header()
    sources["model.c"] = generate_c([node, step])
    flags = FLAGS if processor is None else processor.compiler_flags
    return sources, (*flags, *(f"-D{name}={value}" for name, value in defines.items()))


def _field(model: Model) -> ca.Function:
    x, u = ca.SX.sym("x", model.state_count), ca.SX.sym("u", model.input_count)
    p, e = ca.SX.sym("p", model.parameter_values.size), ca.SX.sym("e", ENVIRONMENT_DEFAULT.size)
    rate = model.derivative(x, u, p, e, ca.SX.zeros(model.hidden_count))
    return ca.Function("field", [x, u, p, e], [rate, ca.jacobian(rate, x), ca.jacobian(rate, u)])


def _functions(model: Model, field: ca.Function) -> tuple[ca.Function, ca.Function]:
    """One RK4 step with its Jacobians, propagated through the stages for less code than by AD, and one without."""
    kind: Any = ca.MX if field.is_a("MXFunction") else ca.SX
    x, u, p, e = (kind.sym(field.name_in(i), field.size1_in(i)) for i in range(4))
    dt = kind.sym("dt")

    def with_sensitivity(state: Expression) -> Expression:
        """d/dt of [x, dx/dx0, dx/du] laid side by side."""
        slope, by_state, by_input = field(state[:, 0], u, p, e)
        forced = ca.horzcat(kind(model.state_count, model.state_count), by_input)
        return ca.horzcat(slope, by_state @ state[:, 1:] + forced)

    start = ca.horzcat(x, kind.eye(model.state_count), kind(model.state_count, model.input_count))
    after = ca.cse(ca.densify(rk4(with_sensitivity, start, dt)))
    parts = ca.horzsplit(after, [0, 1, 1 + model.state_count, 1 + model.state_count + model.input_count])
    node = ca.Function("alula_node", [x, u, p, e, dt], parts)
    plain = rk4(lambda state: field(state, u, p, e)[0], x, dt)
    step = ca.Function("alula_step", [x, u, p, e, dt], [ca.densify(with_unit_attitude(plain))])
    return node, step
