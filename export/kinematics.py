"""A model's motion along inputs in plain NumPy, over whole windows: the reference for the kernels' roll-outs.

Slow and straightforward: every acceleration comes from the interpreted model with its whole window, no column is
streamed, and nothing is shared with the kernels but the formulas of docs/kernel.md.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import casadi as ca
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.integrators import required_steps, rk4
from dynamics.kinematics import kinematic_step
from dynamics.model import ENVIRONMENT_DEFAULT
from dynamics.state import ATTITUDE, HIDDEN, RATE, RIGID_BODY_STATES, VELOCITY
from export.trained import ExportedModel
from runtime.control.rti.problem import Problem

Forward = Callable[[Floats, Floats], list[ca.DM]]


def roll_out(
    model: ExportedModel,
    weighted: ca.Function,
    problem: Problem,
    window: Floats,
    hidden: Floats,
    inputs: Floats,
    *,
    share: float = 1.0,
) -> Floats:
    """(N + 1, nx) states at the nodes after a window (13 + rotors, T or more) and hidden states, along inputs (N, n).

    weighted: `export.symbolic.weighted_function` of the model. share: of the network's output, over the whole horizon.
    """

    def forward(history: Floats, hidden: Floats) -> list[ca.DM]:
        return list(weighted(history, hidden, share))

    start = np.concatenate([window[:RIGID_BODY_STATES, -1], hidden])
    if model.integrator == "rk4":
        return _by_rk4(model, forward, problem, start, inputs)
    return _by_columns(model, forward, problem, window, start, inputs)


def _by_rk4(model: ExportedModel, forward: Forward, problem: Problem, start: Floats, inputs: Floats) -> Floats:
    flown = model.flight_model
    quiet = np.zeros(flown.hidden_count)

    def field(u: Floats, x: Floats) -> Floats:
        if model.network is None:
            rates = flown.derivative(x, u, flown.parameter_values, ENVIRONMENT_DEFAULT, quiet)
            return np.array(rates).ravel()
        rates = _rates(forward, np.concatenate([x[:RIGID_BODY_STATES], u])[:, None], x[HIDDEN])
        turning = np.asarray(quaternion.derivative(x[ATTITUDE], x[RATE]))
        return np.concatenate([x[VELOCITY], rates[:3], turning, rates[3:]])

    x, states = start, [start]
    for u, interval in zip(inputs, problem.intervals, strict=True):
        x = rk4(partial(field, u), x, interval, steps=required_steps(flown, interval))
        states.append(x)
    return np.array(states)


def _by_columns(
    model: ExportedModel, forward: Forward, problem: Problem, window: Floats, start: Floats, inputs: Floats
) -> Floats:
    h, length = model.config.dt, model.history
    columns = list(window[:, :-1].T)
    before = np.zeros(0)
    if model.extrapolated:  # hidden states are not measured: as now, then a step back along their rate
        then, hidden = np.array(columns[-length:]).T, start[HIDDEN]
        before = _rates(forward, then, hidden - h * _rates(forward, then, hidden)[6:])
    x, states = start, [start]
    for u, interval in zip(inputs, problem.intervals, strict=True):
        for _ in range(round(interval / h)):
            columns.append(np.concatenate([x[:RIGID_BODY_STATES], u]))
            rates = _rates(forward, np.array(columns[-length:]).T, x[HIDDEN])
            mean = rates + (rates - before) / 2 if model.extrapolated else rates
            x, before = _moved(x, mean, h), rates
        states.append(x)
    return np.array(states)


def _rates(forward: Forward, window: Floats, hidden: Floats) -> Floats:
    """(6 + hidden,) accelerations, world and body axes, then the hidden states' rates."""
    return np.concatenate([np.array(part).ravel() for part in forward(window, hidden)])


def _moved(x: Floats, mean: Floats, h: float) -> Floats:
    """The state (nx,) after h seconds of mean rates (6 + hidden,)."""
    moved = kinematic_step(x[:RIGID_BODY_STATES], mean[:3], mean[3:6], h)
    return np.concatenate([moved, x[HIDDEN] + h * mean[6:]])
