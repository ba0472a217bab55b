"""Whether a velocity is in the world or on the body, by the motion it must explain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats

_SPAN = 0.1  # s, over which positions are differenced
_CLEARLY = 0.7  # one explanation's error must be below this share of the other's
_FEWEST = 10  # samples
_MIN_DIFFERENCE = 0.05  # m/s rms between both readings, below which it does not matter


@dataclass(frozen=True, eq=False)
class Judged:
    """A velocity in the world, (n, 3) m/s, with the frame it came in and why that is believed."""

    velocity: Floats
    frame: Literal["the world", "the body"]
    reason: str


def velocity_world(time: Floats, position: Floats, attitude: Floats, velocity: Floats) -> Judged:
    """A velocity whose frame is not known, in the world. All (n, k) on one clock.

    Where the motion cannot tell, it is taken for the body's, as REP 147 and nav_msgs/Odometry have it.
    """
    turned = quaternion.rotate(attitude, velocity)
    whole = np.isfinite(turned).all(axis=1) & np.isfinite(position).all(axis=1)
    difference = float(np.sqrt(np.mean((turned - velocity)[whole] ** 2))) if whole.any() else 0.0
    if difference < _MIN_DIFFERENCE or np.count_nonzero(whole) < _FEWEST:
        return Judged(turned, "the body", "as nav_msgs/Odometry defines it; the motion is too small to prove it")
    order = np.flatnonzero(whole)[np.argsort(time[whole], kind="stable")]
    time, position = time[order], position[order]
    before = np.searchsorted(time, time - _SPAN)
    elapsed = time - time[before]
    known = elapsed > 0.5 * _SPAN
    if np.count_nonzero(known) < _FEWEST:
        return Judged(turned, "the body", "as nav_msgs/Odometry defines it; too few samples to prove it")
    moved = (position - position[before])[known] / elapsed[known, None]
    errors = []
    for candidate in (velocity[order], turned[order]):
        mean = 0.5 * (candidate + candidate[before])[known]
        errors.append(float(np.sqrt(np.mean((mean - moved) ** 2))))
    world, body = errors
    if world < _CLEARLY * body:
        return Judged(velocity, "the world", f"measured: {world:.2f} m/s off the position's change, as body {body:.2f}")
    if body < _CLEARLY * world:
        return Judged(turned, "the body", f"measured: {body:.2f} m/s off the position's change, as world {world:.2f}")
    return Judged(
        turned, "the body", f"as nav_msgs/Odometry defines it; the motion does not tell ({world:.2f}, {body:.2f} m/s)"
    )
