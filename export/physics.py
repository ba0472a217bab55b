"""The physical model under a residual network: mean accelerations over a column's time, with their derivatives."""

from __future__ import annotations

import casadi as ca

from dynamics.effect import Expression
from dynamics.integrators import required_steps, rk4
from dynamics.model import ENVIRONMENT_DEFAULT, Model
from dynamics.state import HIDDEN, RATE, VELOCITY

NAME = "alula_physics"


def physics_function(model: Model, *, dt: float, mean: bool) -> ca.Function:
    """(x, u, p, e) -> rates (6 + hidden), by_state, by_input: world and body accelerations, then hidden states' rates.

    mean: over the next dt seconds with the input held, by RK4; else the accelerations at x itself.
    """
    x, u = ca.SX.sym("x", model.state_count), ca.SX.sym("u", model.input_count)
    p, e = ca.SX.sym("p", model.parameter_values.size), ca.SX.sym("e", ENVIRONMENT_DEFAULT.size)
    quiet = ca.SX.zeros(model.hidden_count)

    def field(state: Expression) -> Expression:
        return model.derivative(state, u, p, e, quiet)

    slope = (rk4(field, x, dt, steps=required_steps(model, dt)) - x) / dt if mean else field(x)
    rates = ca.vertcat(slope[VELOCITY], slope[RATE], slope[HIDDEN])
    parts = [ca.densify(part) for part in (rates, ca.jacobian(rates, x), ca.jacobian(rates, u))]
    return ca.Function(NAME, [x, u, p, e], ca.cse(parts), ["x", "u", "p", "e"], ["rates", "by_state", "by_input"])


def depends_on_position(function: ca.Function) -> bool:
    """Whether an acceleration changes with where the vehicle is, as near the ground or a wall."""
    _, columns = function.jac_sparsity(function.index_out("rates"), function.index_in("x")).get_triplet()
    return any(column < 3 for column in columns)
