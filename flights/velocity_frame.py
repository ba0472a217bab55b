"""Detection of a velocity's frame, world or body, by the change of position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats

_SPAN = 0.1  # s, over which positions are differenced
_CLEARLY = 0.7  # one frame's error must be below this share of the other's
_MIN_SAMPLES = 10  # samples
_MIN_DIFFERENCE = 0.05  # m/s rms between both interpretations, below which it does not matter


@dataclass(frozen=True, eq=False)
class WorldVelocity:
    """A velocity in the world.

    velocity: (n, 3) m/s.
    frame: in which it was logged.
    reason: the evidence for the frame.
    """

    velocity: Floats
    frame: Literal["the world", "the body"]
    reason: str


def velocity_world(time: Floats, position: Floats, attitude: Floats, velocity: Floats) -> WorldVelocity:
    """A velocity of unknown frame, in the world. All (n, k) on one clock.

    Where the motion does not decide, the frame is the body's, as REP 147 and nav_msgs/Odometry define it.
    """
    turned = quaternion.rotate(attitude, velocity)
    finite = np.isfinite(turned).all(axis=1) & np.isfinite(position).all(axis=1)
    difference = float(np.sqrt(np.mean((turned - velocity)[finite] ** 2))) if finite.any() else 0.0
    if difference < _MIN_DIFFERENCE or np.count_nonzero(finite) < _MIN_SAMPLES:
        return WorldVelocity(turned, "the body", "as nav_msgs/Odometry defines it; the motion is too small to prove it")
    order = np.flatnonzero(finite)[np.argsort(time[finite], kind="stable")]
    time, position = time[order], position[order]
    before = np.searchsorted(time, time - _SPAN)
    elapsed = time - time[before]
    valid = elapsed > 0.5 * _SPAN
    if np.count_nonzero(valid) < _MIN_SAMPLES:
        return WorldVelocity(turned, "the body", "as nav_msgs/Odometry defines it; too few samples to prove it")
    moved = (position - position[before])[valid] / elapsed[valid, None]
    errors = []
    for candidate in (velocity[order], turned[order]):
        mean = 0.5 * (candidate + candidate[before])[valid]
        errors.append(float(np.sqrt(np.mean((mean - moved) ** 2))))
    world, body = errors
    if world < _CLEARLY * body:
        return WorldVelocity(
            velocity, "the world", f"measured: {world:.2f} m/s off the position's change, as body {body:.2f}"
        )
    if body < _CLEARLY * world:
        return WorldVelocity(
            turned, "the body", f"measured: {body:.2f} m/s off the position's change, as world {world:.2f}"
        )
    return WorldVelocity(
        turned, "the body", f"as nav_msgs/Odometry defines it; the motion does not decide ({world:.2f}, {body:.2f} m/s)"
    )
