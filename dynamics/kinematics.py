"""Motion of a rigid body: a step under constant accelerations, and the acceleration of its points."""

from __future__ import annotations

from dynamics import quaternion
from dynamics import symbolic as ca
from dynamics.libraries import Expression, concatenate, entries
from dynamics.state import ATTITUDE, POSITION, RATE, VELOCITY


def kinematic_step(
    state: Expression, acceleration: Expression, angular_acceleration: Expression, dt: float
) -> Expression:
    """The rigid-body state dt seconds later; the attitude turns by the mean body rate, its length stays.

    state: (..., 13). acceleration: (..., 3) world, m/s^2. angular_acceleration: (..., 3) body, rad/s^2.
    """
    velocity, rate = entries(state, VELOCITY), entries(state, RATE)
    turn = quaternion.exponential(dt * (rate + dt / 2 * angular_acceleration))
    return concatenate(
        [
            entries(state, POSITION) + dt * velocity + dt * dt / 2 * acceleration,
            velocity + dt * acceleration,
            quaternion.multiply(entries(state, ATTITUDE), turn),
            rate + dt * angular_acceleration,
        ]
    )


def lever_arm_acceleration(arm: Expression, rate: Expression, angular_acceleration: Expression) -> Expression:
    """Acceleration of a body's point beyond its centre of mass's: alpha x r + omega x (omega x r), (3,) body, m/s^2.

    arm: (3,) from the centre of mass, m. rate, angular_acceleration: (3,) body, rad/s and rad/s^2. For CasADi.
    """
    return ca.cross(angular_acceleration, arm) + ca.cross(rate, ca.cross(rate, arm))
