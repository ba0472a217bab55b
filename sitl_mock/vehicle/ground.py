"""The ground: legs and hull of the vehicle on a flat, rough, slightly soft surface.

Each contact point carries a share of a spring-damper and Coulomb friction. Forces are computed for a unit of mass,
so that every vehicle sinks in equally; the stiffness is soft enough for 1 ms steps.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.effect import Expression
from dynamics.state import ATTITUDE, RATE, VELOCITY
from dynamics.vehicle import GRAVITY, Vehicle

NATURAL_FREQUENCY = 60.0  # of the vehicle on its legs, rad/s
DAMPING_RATIO = 0.7
FRICTION = 0.7
STICTION_SPEED = 0.02  # below it friction grows with speed instead of sliding, m/s
SINKAGE = GRAVITY / NATURAL_FREQUENCY**2  # under the vehicle's own weight, m


def leg_height(vehicle: Vehicle) -> float:
    """Height of the body's origin over its feet, m: 0.3 of the longest arm."""
    arms = np.linalg.norm(np.array(vehicle.rotors.position)[:, 0:2], axis=1)
    return 0.3 * float(arms.max())


def contact_points(vehicle: Vehicle) -> NDArray[np.float64]:
    """Feet below the rotors and hull points above them, body FLU, m. Returns (3, 2 rotors)."""
    hubs = np.array(vehicle.rotors.position).T
    height = leg_height(vehicle)
    feet, hull = hubs.copy(), hubs.copy()
    feet[2] = -height
    hull[2] = hubs[2] + 0.5 * height
    return np.hstack([feet, hull])


def contact_acceleration(
    x: Expression, points: Expression, mass_over_inertia: Expression, ground_height: Expression
) -> tuple[Expression, Expression]:
    """Acceleration by the ground: linear in the world (3,), m/s^2, and angular about body axes (3,), rad/s^2.

    x: rigid-body state. points: (3, n) from the centre of mass, body FLU. mass_over_inertia: (3,) 1/m^2.
    """
    rotation, rate = quaternion.rotation_matrix(x[ATTITUDE]), x[RATE]
    share = 2.0 / points.shape[1]  # half of the points touch in any rest position
    linear, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    for i in range(points.shape[1]):
        depth = ground_height - x[2] - ca.dot(rotation[2, :].T, points[:, i])
        velocity = x[VELOCITY] + rotation @ ca.cross(rate, points[:, i])
        force = share * _point_force(depth, velocity)
        linear = linear + force
        moment = moment + ca.cross(points[:, i], rotation.T @ force)
    return linear, mass_over_inertia * moment


def _point_force(depth: Expression, velocity: Expression) -> Expression:
    """Force on the whole weight's share of a point, per unit of mass, world axes, m/s^2."""
    damping = 2 * DAMPING_RATIO * NATURAL_FREQUENCY * ca.fmin(1, ca.fmax(depth, 0) / SINKAGE)
    normal = ca.if_else(depth > 0, ca.fmax(0, NATURAL_FREQUENCY**2 * depth - damping * velocity[2]), 0)
    sliding = ca.sqrt(velocity[0] ** 2 + velocity[1] ** 2)
    drag = -FRICTION * normal / ca.fmax(sliding, STICTION_SPEED)
    return ca.vertcat(drag * velocity[0], drag * velocity[1], normal)
