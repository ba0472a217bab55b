"""The state as a learned model takes it: the part of a column of its inputs that is not rotor speeds.

The kernel's C (`runtime/control/rti`) holds the same in the same order.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from dynamics import quaternion
from dynamics.libraries import Expression, concatenate, entries
from dynamics.state import ATTITUDE, RATE, VELOCITY

Frame = Literal["world", "body"]
DOWN = np.array([0.0, 0.0, -1.0])  # direction of gravity, world

STATE_INPUTS: dict[Frame, tuple[str, ...]] = {
    "world": (
        "velocity_x", "velocity_y", "velocity_z", "attitude_w", "attitude_x", "attitude_y", "attitude_z",
        "rate_x", "rate_y", "rate_z",
    ),
    "body": (
        "velocity_body_x", "velocity_body_y", "velocity_body_z", "gravity_x", "gravity_y", "gravity_z",
        "rate_x", "rate_y", "rate_z",
    ),
}  # fmt: skip


def state_inputs(frame: Frame, state: Expression) -> Expression:
    """(..., k) entries named in `STATE_INPUTS`: m/s, unit quaternion or unit vector, rad/s.

    frame: "body": velocity and the direction of gravity in body axes, which do not depend on yaw.
    state: (..., 13).
    """
    velocity, attitude = entries(state, VELOCITY), entries(state, ATTITUDE)
    if frame == "body":
        velocity, attitude = (quaternion.rotate_inverse(attitude, vector) for vector in (velocity, DOWN))
    return concatenate([velocity, attitude, entries(state, RATE)])
