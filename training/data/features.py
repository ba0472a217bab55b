"""From a flight's state and motors to a network's columns, and between accelerations and a network's outputs.

"Body accelerations", (n, 6), are the common form of all models here: specific force (m/s^2) and angular acceleration
(rad/s^2), both in body axes. World acceleration is R f - g.
"""

from __future__ import annotations

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.network_inputs import state_inputs
from dynamics.vehicle import GRAVITY, Vehicle
from training.config import ModelConfig

UP = np.array([0.0, 0.0, 1.0])


def columns(config: ModelConfig, state: Floats, rotor_speed: Floats) -> Floats:
    """(..., inputs) columns of `ModelConfig.input_names`. state: (..., 13). rotor_speed: (..., rotors) rad/s."""
    return np.concatenate([state_inputs(config.inputs, state), rotor_speed], axis=-1)


def body_accelerations(world: Floats, attitude: Floats) -> Floats:
    """World acceleration and angular acceleration (n, 6) as body accelerations. attitude: (n, 4)."""
    force = quaternion.rotate_inverse(attitude, world[:, :3] + GRAVITY * UP)
    return np.hstack([force, world[:, 3:]])


def world_accelerations(body: Floats, attitude: Floats) -> Floats:
    """The inverse of `body_accelerations`."""
    return np.hstack([quaternion.rotate(attitude, body[:, :3]) - GRAVITY * UP, body[:, 3:]])


def outputs_from(config: ModelConfig, vehicle: Vehicle, body: Floats, base: Floats | None, attitude: Floats) -> Floats:
    """Outputs (n, 6) of a network whose model gives these body accelerations. base: (n, 6), None for none."""
    residual = body if base is None else body - base
    if config.outputs == "wrench":
        return residual * body_inertia(vehicle)
    if config.outputs == "body":
        return residual
    if base is None:
        return world_accelerations(body, attitude)
    return np.hstack([quaternion.rotate(attitude, residual[:, :3]), residual[:, 3:]])


def accelerations_from(
    config: ModelConfig, vehicle: Vehicle, outputs: Floats, base: Floats | None, attitude: Floats
) -> Floats:
    """Body accelerations (n, 6) of a model whose network has these outputs: the inverse of `outputs_from`."""
    if config.outputs == "wrench":
        residual = outputs / body_inertia(vehicle)
    elif config.outputs == "body":
        residual = outputs
    elif base is None:
        return body_accelerations(outputs, attitude)
    else:
        residual = np.hstack([quaternion.rotate_inverse(attitude, outputs[:, :3]), outputs[:, 3:]])
    return residual if base is None else base + residual


def body_inertia(vehicle: Vehicle) -> Floats:
    """(6,) mass thrice and the inertia: residual force and torque over body accelerations (supplement eq. 1)."""
    return np.array([*[vehicle.body.mass] * 3, *vehicle.body.inertia])
