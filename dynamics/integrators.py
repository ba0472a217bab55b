"""Integration of a model over time, as CasADi expressions and functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from dynamics import symbolic as ca
from dynamics.effect import Expression
from dynamics.model import Model
from dynamics.state import ATTITUDE, HIDDEN, RIGID_BODY_STATES

Field = Callable[[Expression], Expression]
DrivenField = Callable[[Expression, float], Expression]
SMALL_EXPONENT, SERIES_TERMS = 0.3, 9  # below which a series replaces quotients that cancel: both right to 1e-13
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


def exponential_step(field: DrivenField, x: Expression, relaxation: Expression, dt: Expression) -> Expression:
    """One step of xdot = field(x, s), exact and stable for entries that relax however fast.

    Cox, Matthews, Exponential time differencing for stiff systems, 2002, ETDRK4.

    s: share of the step that has passed.
    relaxation: (nx,) d field_i / d x_i, 1/s, of entries that relax, 0 for the others, which take the classical
        Runge-Kutta step. An entry that is linear in itself and depends on nothing but an input that changes linearly
        over the step is exact.
    """
    half, full = relaxation * dt / 2, relaxation * dt
    phi_half, (phi1, phi2, phi3) = _phi(half)[0], _phi(full)
    decay_half, decay = 1 + half * phi_half, 1 + full * phi1

    def rest(state: Expression, share: float) -> Expression:
        return field(state, share) - relaxation * state

    n0 = rest(x, 0.0)
    a = decay_half * x + dt / 2 * phi_half * n0
    na = rest(a, 0.5)
    b = decay_half * x + dt / 2 * phi_half * na
    nb = rest(b, 0.5)
    c = decay_half * a + dt / 2 * phi_half * (2 * nb - n0)
    nc = rest(c, 1.0)
    weights = (phi1 - 3 * phi2 + 4 * phi3, 2 * phi2 - 4 * phi3, 4 * phi3 - phi2)
    return decay * x + dt * (weights[0] * n0 + weights[1] * (na + nb) + weights[2] * nc)


def exponential_steps(
    field: DrivenField, x: Expression, relaxation: Expression, dt: Expression, *, steps: int
) -> Expression:
    """Integration in equal exponential steps over dt."""

    def of_step(i: int) -> DrivenField:
        return lambda state, share: field(state, (i + share) / steps)

    for i in range(steps):
        x = exponential_step(of_step(i), x, relaxation, dt / steps)
    return x


def relaxation_of(derivative: Expression, hidden: Expression) -> Expression:
    """(h,) d derivative_i / d hidden_i, 1/s, where that depends on no hidden state, 0 elsewhere.

    derivative: (h,) of the hidden states, an expression in them.
    """
    slopes = ca.jacobian(derivative, hidden)
    own = [slopes[i, i] for i in range(slopes.shape[0])]
    return ca.vertcat(*[ca.SX(0) if ca.depends_on(slope, hidden) else ca.densify(slope) for slope in own])


def relaxes_alone(derivative: Expression, hidden: Expression, entries: slice) -> bool:
    """Whether each of these hidden states is linear in itself and depends on no other hidden state."""
    slopes = ca.jacobian(derivative, hidden)[entries, :]
    rows, columns = slopes.sparsity().get_triplet()
    diagonal = all(row + entries.start == column for row, column in zip(rows, columns, strict=True))
    return diagonal and not ca.depends_on(slopes, hidden)


def lag_places(model: Model) -> tuple[list[int], list[int]]:
    """Places of the time constants among the parameters: of all effects, and of those that bound the integration step.

    Hidden states that relax by themselves are integrated exactly, so that their time constants bound nothing.
    """
    hidden = ca.SX.sym("hidden", model.hidden_count)
    sizes = [model.input_count, len(model.parameter_names), 2, model.hidden_count]
    x = ca.vertcat(ca.SX.sym("x", RIGID_BODY_STATES), hidden)
    derivative = model.derivative(x, *(ca.SX.sym("argument", size) for size in sizes))[HIDDEN]
    everything: list[int] = []
    bounding: list[int] = []
    for item in model.effects:
        places = [model.parameter_index(f"{item.key}.{name}") for name in item.effect.time_constants]
        everything += places
        states = [slice(s.start - RIGID_BODY_STATES, s.stop - RIGID_BODY_STATES) for s in item.hidden.values()]
        if not all(relaxes_alone(derivative, hidden, entries) for entries in states):
            bounding += places
    return everything, bounding


def _phi(z: Expression) -> tuple[Expression, Expression, Expression]:
    """phi_k(z) = sum over n of z^n / (n + k)!, k = 1, 2, 3, without cancellation at small z."""
    small = ca.fabs(z) < SMALL_EXPONENT
    safe = ca.if_else(small, 1.0, z)
    series = [sum(z**n / math.factorial(n + k) for n in range(SERIES_TERMS)) for k in (1, 2, 3)]
    first = ca.expm1(safe) / safe
    second = (first - 1) / safe
    third = (second - 0.5) / safe
    exact = (first, second, third)
    return tuple(ca.if_else(small, s, e) for s, e in zip(series, exact, strict=True))


def required_steps(model: Model, duration: float) -> int:
    """RK4 steps over a duration, s, of which none is longer than the shortest time constant of the model allows."""
    return steps_within(model.time_constants, duration)


def max_step(time_constants: Sequence[float]) -> float:
    """The longest RK4 step, s, that the shortest time constant, s, allows; infinite without any."""
    return min((MAX_STEP_IN_LAGS * lag for lag in time_constants), default=math.inf)


def steps_within(time_constants: Sequence[float], duration: float) -> int:
    """RK4 steps over a duration, s, of which none is longer than the shortest time constant, s, allows."""
    return max(1, math.ceil(duration / max_step(time_constants)))


def with_unit_attitude(x: Expression) -> Expression:
    """State with its quaternion at unit length."""
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
