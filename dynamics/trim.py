"""Trim: how a vehicle with effects hovers, what it weighs then and how fast each of its rotors turns."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.model import ENVIRONMENT_DEFAULT, Model
from dynamics.vehicle import GRAVITY, Vehicle

ITERATIONS = 20
HIGH_UP = 100.0  # m, where no ground is felt
SAME = 1e-6  # relative difference that counts as none: a vehicle whose effects vanish in hover is left as it was


@dataclass(frozen=True, eq=False)
class Trim:
    """vehicle: the one without effects that weighs and thrusts as the model does in hover, for everything that thinks
    in weights: references, take-off, thrust map, landing. rotor_speed: (rotors,) rad/s, without any turning.
    """

    vehicle: Vehicle
    rotor_speed: Floats

    @property
    def shares(self) -> Floats:
        """(rotors,) speed of each rotor over the hover speed of the vehicle without effects."""
        return np.asarray(self.rotor_speed / self.vehicle.hover_speed)


def find_trim(model: Model) -> Trim:
    """Hover of a model, level and at rest: thrust that carries the weight, no angular acceleration.

    Forces sideways, which the vehicle would have to lean against, are not in it. The least change of rotor speeds is
    taken where there are more than four.
    """
    vehicle = model.vehicle
    even = np.full(model.input_count, vehicle.hover_speed)
    if not model.effects:
        return Trim(vehicle, even)
    respond = _hover_response(model)
    speed = even
    for _ in range(ITERATIONS):
        found, slope = (np.array(value) for value in respond(speed))
        step = np.linalg.lstsq(slope, found.ravel(), rcond=None)[0]
        speed = np.maximum(speed - step, 0.1 * vehicle.hover_speed)
    constants = model.thrust_constants
    mass = float(constants @ speed**2) / GRAVITY
    constant = float(np.mean(constants))
    body, rotors = vehicle.body, vehicle.rotors
    if abs(mass - body.mass) > SAME * body.mass:
        body = msgspec.structs.replace(body, mass=mass)
    if abs(constant - rotors.thrust_constant) > SAME * rotors.thrust_constant:
        rotors = msgspec.structs.replace(rotors, thrust_constant=constant)
    trimmed = msgspec.structs.replace(vehicle, body=body, rotors=rotors, effects=())
    return Trim(trimmed, np.where(np.abs(speed - even) > SAME * even, speed, even))


def _hover_response(model: Model) -> ca.Function:
    """(rotor speeds) -> what is left of (vertical, angular) acceleration, level and at rest, and its Jacobian."""
    speed = ca.SX.sym("speed", model.input_count)
    state = ca.SX(model.initial_state(np.array([0.0, 0.0, HIGH_UP, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])))
    for place in model.rotor_speed_places:
        state[place] = speed
    force, angular, _ = model.observe(state, speed, model.parameter_values, ENVIRONMENT_DEFAULT)
    left = ca.vertcat(force[2] - GRAVITY, angular)
    return ca.Function("hover_response", [speed], [left, ca.jacobian(left, speed)])
