"""Integration of a model over time, as CasADi expressions and functions."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca

from dynamics.effect import Expression
from dynamics.model import Model
from dynamics.state import ATTITUDE

Field = Callable[[Expression], Expression]
DrivenField = Callable[[Expression, float], Expression]
MAX_STEP_IN_LAGS = 1.0  # RK4 steps stay within one time constant of the fastest lag: stable and accurate


def rk4(field: Field, x: Expression, dt: Expression, *, steps: int = 1) -> Expression:
    """Classical Runge-Kutta steps of xdot = field(x), dt seconds in all."""
    for _ in range(steps):
        x = rk4_driven(lambda state, _: field(state), x, dt / steps if steps > 1 else dt)
    return x


def rk4_driven(field: DrivenField, x: Expression, dt: Expression) -> Expression:
    """One classical Runge-Kutta step of xdot = field(x, s) over dt seconds. s: share of the step that has passed."""
    k1 = field(x, 0.0)
    k2 = field(x + dt / 2 * k1, 0.5)
    k3 = field(x + dt / 2 * k2, 0.5)
    k4 = field(x + dt * k3, 1.0)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def required_steps(model: Model, duration: float) -> int:
    """RK4 steps over a duration, s, of which none is longer than the shortest time constant of the model allows."""
    return max([1, *(math.ceil(duration / (MAX_STEP_IN_LAGS * lag)) for lag in model.time_constants)])


def with_unit_attitude(x: Expression) -> Expression:
    """The same state with its quaternion at unit length."""
    return ca.vertcat(x[: ATTITUDE.start], x[ATTITUDE] / ca.norm_2(x[ATTITUDE]), x[ATTITUDE.stop :])


def step_function(model: Model, *, substeps: int = 1, name: str = "step") -> ca.Function:
    """The model over a time step: (x, u, p, e, w, dt) -> next x, by RK4 with the quaternion normalised.

    w is the white noise averaged over the step: unit normal numbers divided by sqrt(dt).
    """
    x, u, p, e, w = (ca.SX.sym(name, *shape) for name, shape in _arguments(model))
    dt = ca.SX.sym("dt")
    after = rk4(lambda state: model.derivative(state, u, p, e, w), x, dt, steps=substeps)
    return ca.Function(
        name, [x, u, p, e, w, dt], [with_unit_attitude(after)], ["x", "u", "p", "e", "w", "dt"], ["next"]
    )


def _arguments(model: Model) -> list[tuple[str, tuple[int, int]]]:
    return [(model.derivative.name_in(i), model.derivative.size_in(i)) for i in range(model.derivative.n_in())]
