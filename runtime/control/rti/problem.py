"""The optimal control problem: cost, horizon and bounds, and its C options for one model."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import msgspec
import numpy as np

from dynamics.arrays import Floats, Vector3
from dynamics.controller_settings import ControllerSettings, intervals_of
from dynamics.state import POSITION, RATE, RIGID_BODY_STATES, VELOCITY
from dynamics.trim import Trim
from runtime.control.kernel_model import FlownModel, trim_of

# Rotors at rest cannot be linearised: thrust goes with the square of the speed, so at zero its derivative vanishes and
# the solver would never turn them on again, and without thrust no tilt moves the vehicle, so that a vehicle that has to
# fall was turned over. At this share of hover speed a rotor gives 9 % of its hover thrust.
MIN_SPEED = 0.3
INPUT_SCALE = 0.1  # of hover speed: one unit of a scaled input
DEFAULTS = ControllerSettings()


class Weights(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Diagonals of Q_x and Q_u in PI-TCN eq. 7, per unit squared; see `ControllerSettings`.

    position: 1/m^2.
    velocity: 1/(m/s)^2.
    attitude: on quaternion components.
    rate: 1/(rad/s)^2.
    input: on rotor speed over hover speed.
    terminal: factor from Q to the last node's weight.
    """

    position: Vector3 = DEFAULTS.position_weight
    velocity: Vector3 = DEFAULTS.velocity_weight
    attitude: float = DEFAULTS.attitude_weight
    rate: Vector3 = DEFAULTS.rate_weight
    input: float = DEFAULTS.input_weight
    terminal: float = DEFAULTS.terminal_weight


class Problem(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The optimal control problem.

    nodes: N.
    horizon: s.
    growth: length of each interval over the one before, 1 for equal ones.
    levenberg_marquardt: added to the Hessian's diagonal.
    tolerance: of the quadratic program's optimality.
    iterations: at most.
    preparation_iterations: at most, before the state is measured.
    soft_penalty: price of leaving such a bound (body rates, velocity by axis, thrust, box), linear and quadratic.
    keep_in_box: whether the prediction keeps to the vehicle file's position box, if it has one.
    """

    nodes: int = DEFAULTS.nodes
    horizon: float = DEFAULTS.horizon
    growth: float = DEFAULTS.growth
    weights: Weights = Weights()
    levenberg_marquardt: float = DEFAULTS.levenberg_marquardt
    tolerance: float = DEFAULTS.tolerance
    iterations: int = DEFAULTS.iterations
    preparation_iterations: int = DEFAULTS.preparation_iterations
    soft_penalty: float = DEFAULTS.soft_penalty
    keep_in_box: bool = DEFAULTS.keep_in_box

    @classmethod
    def from_settings(cls, settings: ControllerSettings) -> Problem:
        """The problem of a vehicle file's [controller]."""
        weights = Weights(
            position=settings.position_weight,
            velocity=settings.velocity_weight,
            attitude=settings.attitude_weight,
            rate=settings.rate_weight,
            input=settings.input_weight,
            terminal=settings.terminal_weight,
        )
        return cls(
            nodes=settings.nodes,
            horizon=settings.horizon,
            growth=settings.growth,
            weights=weights,
            levenberg_marquardt=settings.levenberg_marquardt,
            tolerance=settings.tolerance,
            iterations=settings.iterations,
            preparation_iterations=settings.preparation_iterations,
            soft_penalty=settings.soft_penalty,
            keep_in_box=settings.keep_in_box,
        )

    @property
    def intervals(self) -> tuple[float, ...]:
        """(N,) lengths of the intervals between nodes, s. Stage k weighs intervals[k] / intervals[0] times the cost."""
        return intervals_of(self.horizon, self.nodes, self.growth)

    @property
    def node(self) -> float:
        """Length of the first interval, s."""
        return self.intervals[0]

    @property
    def offsets(self) -> Floats:
        """(N + 1,) times of the nodes after the first, s."""
        if self.growth == 1.0:
            return self.node * np.arange(self.nodes + 1, dtype=np.float64)
        return np.concatenate([[0.0], np.cumsum(self.intervals)])


def options_struct(states: int, inputs: int, nodes: int) -> type[ctypes.Structure]:
    """The C struct rti_options (condensed.h) for a number of states, inputs and nodes."""
    d = ctypes.c_double
    vectors = {"Q": states, "P": states, "R": inputs, "u_lower": inputs, "u_upper": inputs}
    fields: list[tuple[str, Any]] = [(name, d * size) for name, size in vectors.items()]
    fields += [("x_lower", d * states), ("x_upper", d * states), ("thrust_constant", d * inputs)]
    names = ("thrust_lower", "thrust_upper", "scale", "levenberg_marquardt", "tolerance")
    fields += [("interval", d * nodes), *((name, d) for name in (*names, "penalty"))]
    fields += [("iterations", ctypes.c_int), ("preparation_iterations", ctypes.c_int)]
    return type("RtiOptions", (ctypes.Structure,), {"_fields_": fields})


def fill_options(problem: Problem, model: FlownModel, trim: Trim | None = None) -> ctypes.Structure:
    """The C options of a problem for one model's vehicle. trim: of the model, computed if it is None."""
    vehicle, weights = model.vehicle, problem.weights
    hover_speed = (trim or trim_of(model)).vehicle.hover_speed
    states, inputs = model.state_count, model.input_count
    hidden = [0.0] * (states - RIGID_BODY_STATES)
    options = options_struct(states, inputs, problem.nodes)()
    stage = [*weights.position, *weights.velocity, *[weights.attitude] * 4, *weights.rate, *hidden]
    options.Q[:] = stage
    options.P[:] = [weights.terminal * weight for weight in stage]
    options.R[:] = [weights.input / hover_speed**2] * inputs
    options.u_lower[:] = [max(vehicle.rotors.speed_min, MIN_SPEED * hover_speed)] * inputs
    options.u_upper[:] = [vehicle.rotors.speed_max] * inputs
    lower, upper = [-math.inf] * states, [math.inf] * states
    lower[RATE], upper[RATE] = [-rate for rate in vehicle.limits.rate], list(vehicle.limits.rate)
    lower[VELOCITY], upper[VELOCITY] = [-vehicle.limits.speed] * 3, [vehicle.limits.speed] * 3
    if problem.keep_in_box and vehicle.limits.box is not None:
        lower[POSITION], upper[POSITION] = vehicle.limits.box
    options.x_lower[:], options.x_upper[:] = lower, upper
    options.thrust_lower, options.thrust_upper = vehicle.limits.thrust or (-math.inf, math.inf)
    options.thrust_constant[:] = model.thrust_constants
    options.interval[:], options.scale = problem.intervals, INPUT_SCALE * hover_speed
    options.levenberg_marquardt, options.tolerance = problem.levenberg_marquardt, problem.tolerance
    options.penalty = problem.soft_penalty
    options.iterations, options.preparation_iterations = problem.iterations, problem.preparation_iterations
    return options
