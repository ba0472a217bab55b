"""Trim: the hover of a vehicle with effects, its weight there and the speed of each rotor."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from dynamics import symbolic as ca
from dynamics.allocation import mixer
from dynamics.arrays import Floats
from dynamics.errors import RequestError
from dynamics.model import ENVIRONMENT_DEFAULT, Model
from dynamics.vehicle import GRAVITY, Vehicle

ITERATIONS = 20
LEFT = np.array([0.01, 0.01, 0.01, 0.01])  # m/s^2 upwards and rad/s^2, up to which a hover has been found
FAR_FROM_GROUND = 100.0  # m, beyond ground effect
NEGLIGIBLE = 1e-6  # relative difference: a vehicle whose effects vanish in hover stays as it is


@dataclass(frozen=True, eq=False)
class Trim:
    """A hover.

    vehicle: without effects, with the mass and thrust constant that the model has in hover: for references, take-off,
        thrust map and landing.
    rotor_speed: (rotors,) rad/s, without angular acceleration.
    """

    vehicle: Vehicle
    rotor_speed: Floats

    @property
    def shares(self) -> Floats:
        """(rotors,) speed of each rotor over the hover speed of the vehicle without effects."""
        return np.asarray(self.rotor_speed / self.vehicle.hover_speed)


def find_trim(model: Model) -> Trim:
    """Hover of a model, level and at rest: thrust that carries the weight, no angular acceleration.

    Horizontal forces, against which the vehicle would have to tilt, are left out. With more than four rotors their
    speeds change as little as possible.

    Raises RequestError where no rotor speeds of the vehicle do that.
    """
    vehicle = model.vehicle
    if not model.effects:
        return trim_without_effects(vehicle)
    respond = _hover_response(model)
    speed = even = trim_without_effects(vehicle).rotor_speed
    for _ in range(ITERATIONS):
        error, slope = (np.array(value) for value in respond(speed))
        step = np.linalg.lstsq(slope, error.ravel(), rcond=None)[0]
        speed = np.maximum(speed - step, 0.1 * vehicle.hover_speed)
    left = np.array(respond(speed)[0]).ravel()
    if not np.all(np.abs(left) <= LEFT) or speed.max() > vehicle.rotors.speed_max:
        names = ", ".join(dict.fromkeys(item.effect.name for item in model.effects))
        raise RequestError(
            f"{vehicle.name} cannot hover with its effects, {names}: {left[0]:.2g} m/s^2 upwards and "
            f"{np.abs(left[1:]).max():.2g} rad/s^2 are left with rotors at up to {speed.max():.0f} of "
            f"{vehicle.rotors.speed_max:.0f} rad/s. Check their values."
        )
    thrust_constants = model.thrust_constants
    mass = float(thrust_constants @ speed**2) / GRAVITY
    speed = np.where(np.abs(speed - even) > NEGLIGIBLE * even, speed, even)
    return trim_at(vehicle, mass, float(np.mean(thrust_constants)), speed)


def trim_without_effects(vehicle: Vehicle) -> Trim:
    """Hover of the nominal model: all rotors share the weight."""
    return Trim(vehicle, np.full(vehicle.rotors.count, vehicle.hover_speed))


def trim_at(vehicle: Vehicle, mass: float, thrust_constant: float, rotor_speed: Floats) -> Trim:
    """The trim of a hover with this mass, kg, and thrust constant, N s^2/rad^2, at rotor speeds (rotors,) rad/s.

    Negligible differences from the vehicle's own constants are dropped.
    """
    body, rotors = vehicle.body, vehicle.rotors
    if abs(mass - body.mass) > NEGLIGIBLE * body.mass:
        body = msgspec.structs.replace(body, mass=mass)
    if abs(thrust_constant - rotors.thrust_constant) > NEGLIGIBLE * rotors.thrust_constant:
        rotors = msgspec.structs.replace(rotors, thrust_constant=thrust_constant)
    return Trim(msgspec.structs.replace(vehicle, body=body, rotors=rotors, effects=()), rotor_speed)


def trim_authority(model: Model) -> Floats:
    """Angular acceleration of a unit of PX4's normalised torque about body x, y, z in hover, rad/s^2. Returns (3,)."""
    speed = find_trim(model).rotor_speed
    slope = np.array(_hover_response(model)(speed)[1])[1:]
    of_whole_thrust = model.vehicle.rotors.speed_max**2 / (2 * speed)  # rad/s of a rotor
    return np.asarray(np.diag(slope @ (of_whole_thrust[:, None] * mixer(model.vehicle)[:, :3])))


def _hover_response(model: Model) -> ca.Function:
    """(rotor speeds) -> (vertical, angular) acceleration, level and at rest, and its Jacobian."""
    speed = ca.SX.sym("speed", model.input_count)
    state = ca.SX(model.initial_state(np.array([0.0, 0.0, FAR_FROM_GROUND, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])))
    for place in model.rotor_speed_places:
        state[place] = speed
    force, angular, _ = model.observe(state, speed, model.parameter_values, ENVIRONMENT_DEFAULT)
    residual = ca.vertcat(force[2] - GRAVITY, angular)
    return ca.Function("hover_response", [speed], [residual, ca.jacobian(residual, speed)])
