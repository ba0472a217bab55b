"""The kinematic step: the motion of a rigid body under accelerations that are constant over the step."""

from __future__ import annotations

from dynamics import quaternion
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
