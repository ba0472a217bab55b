"""What the controller is asked to minimise, and within which bounds."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import msgspec

from dynamics.model import Model
from dynamics.state import RIGID_BODY_STATES
from dynamics.vehicle import Vector3

# Rotors at rest cannot be linearised: thrust goes with the square of the speed, so at zero its derivative vanishes and
# the solver would never turn them on again. At this share of hover speed a rotor gives 2 % of its hover thrust.
MIN_SPEED = 0.15


class Weights(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Diagonals of Q_x and Q_u in PI-TCN eq. 7, per unit squared.

    position: 1/m^2. velocity: 1/(m/s)^2. attitude: on quaternion components. rate: 1/(rad/s)^2. input: on rotor speed
    over hover speed. terminal: factor from Q to the last node's weight.
    """

    position: Vector3 = (60.0, 60.0, 60.0)
    velocity: Vector3 = (1.0, 1.0, 1.0)
    attitude: float = 8.0
    rate: Vector3 = (0.05, 0.05, 0.05)
    input: float = 4.0
    terminal: float = 3.0


class Problem(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The optimal control problem. nodes: N. horizon: s. levenberg_marquardt: added to the Hessian's diagonal.

    tolerance, iterations: HPIPM's; row_iterations: the same when bounds on states or thrust act. soft_penalty: price of
    leaving such a bound (body rates, velocity by axis, thrust, box), linear and quadratic. keep_in_box: hold the
    vehicle file's position box, if it has one, in the prediction as well.
    """

    nodes: int = 20
    horizon: float = 1.0
    weights: Weights = Weights()
    levenberg_marquardt: float = 1e-3
    tolerance: float = 1e-5
    iterations: int = 50
    row_iterations: int = 25
    soft_penalty: float = 300.0
    keep_in_box: bool = True

    @property
    def node(self) -> float:
        """Length of a node, s."""
        return self.horizon / self.nodes


def options_struct(states: int, inputs: int) -> type[ctypes.Structure]:
    """The C struct rti_options for so many states and inputs."""
    d = ctypes.c_double
    vectors = {"Q": states, "P": states, "R": inputs, "u_lower": inputs, "u_upper": inputs}
    fields: list[tuple[str, Any]] = [(name, d * size) for name, size in vectors.items()]
    fields += [("x_lower", d * states), ("x_upper", d * states)]
    names = ("thrust_lower", "thrust_upper", "thrust_constant", "node", "scale", "levenberg_marquardt", "tolerance")
    fields += [(name, d) for name in (*names, "penalty")]
    fields += [("iterations", ctypes.c_int), ("row_iterations", ctypes.c_int)]
    return type("RtiOptions", (ctypes.Structure,), {"_fields_": fields})


def fill_options(problem: Problem, model: Model) -> ctypes.Structure:
    """The C options of a problem for one model's vehicle."""
    vehicle, weights = model.vehicle, problem.weights
    states, inputs = model.state_count, model.input_count
    hidden = [0.0] * (states - RIGID_BODY_STATES)
    options = options_struct(states, inputs)()
    stage = [*weights.position, *weights.velocity, *[weights.attitude] * 4, *weights.rate, *hidden]
    options.Q[:] = stage
    options.P[:] = [weights.terminal * weight for weight in stage]
    options.R[:] = [weights.input / vehicle.hover_speed**2] * inputs
    options.u_lower[:] = [max(vehicle.rotors.speed_min, MIN_SPEED * vehicle.hover_speed)] * inputs
    options.u_upper[:] = [vehicle.rotors.speed_max] * inputs
    lower, upper = [-math.inf] * states, [math.inf] * states
    lower[10:13], upper[10:13] = [-rate for rate in vehicle.limits.rate], list(vehicle.limits.rate)
    lower[3:6], upper[3:6] = [-vehicle.limits.speed] * 3, [vehicle.limits.speed] * 3
    if problem.keep_in_box and vehicle.limits.box is not None:
        lower[0:3], upper[0:3] = vehicle.limits.box
    options.x_lower[:], options.x_upper[:] = lower, upper
    options.thrust_lower, options.thrust_upper = vehicle.limits.thrust or (-math.inf, math.inf)
    options.thrust_constant = vehicle.rotors.thrust_constant
    options.node, options.scale = problem.node, 0.1 * vehicle.hover_speed
    options.levenberg_marquardt, options.tolerance = problem.levenberg_marquardt, problem.tolerance
    options.penalty = problem.soft_penalty
    options.iterations, options.row_iterations = problem.iterations, problem.row_iterations
    return options
