"""Steps of a model over time, as CasADi expressions and functions."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from dynamics.effect import Expression
from dynamics.model import Model

Field = Callable[[Expression], Expression]


def rk4(field: Field, x: Expression, dt: Expression) -> Expression:
    """One classical Runge-Kutta step of xdot = field(x) over dt seconds."""
    k1 = field(x)
    k2 = field(x + dt / 2 * k1)
    k3 = field(x + dt / 2 * k2)
    k4 = field(x + dt * k3)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def with_unit_attitude(x: Expression) -> Expression:
    """The same state with its quaternion at unit length."""
    return ca.vertcat(x[0:6], x[6:10] / ca.norm_2(x[6:10]), x[10:])


def step_function(model: Model, *, substeps: int = 1, name: str = "step") -> ca.Function:
    """The model over a time step: (x, u, p, e, w, dt) -> next x, by RK4 with the quaternion normalised.

    w is the white noise averaged over the step: unit normal numbers divided by sqrt(dt).
    """
    x, u, p, e, w = (ca.SX.sym(name, *shape) for name, shape in _arguments(model))
    dt = ca.SX.sym("dt")
    after = x
    for _ in range(substeps):
        after = rk4(lambda state: model.derivative(state, u, p, e, w), after, dt / substeps)
    return ca.Function(
        name, [x, u, p, e, w, dt], [with_unit_attitude(after)], ["x", "u", "p", "e", "w", "dt"], ["next"]
    )


def _arguments(model: Model) -> list[tuple[str, tuple[int, int]]]:
    return [(model.derivative.name_in(i), model.derivative.size_in(i)) for i in range(model.derivative.n_in())]
