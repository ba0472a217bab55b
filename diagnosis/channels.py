"""The twelve residual channels: four kinds of measurement, three axes each.

imu             specific force of the accelerometer, m/s^2
mocap           acceleration from position or velocity, less gravity, in body axes, m/s^2
angular         angular acceleration from the gyro, rad/s^2
attitude_rate   the attitude's turning less the gyro, rad/s

A real force shows alike in imu and mocap, a torque in angular, an accelerometer's bias in imu only, a gyro's in
attitude_rate only, a clock offset in mocap and attitude_rate. All products are formed at the full rate; then both
sides go through one filter, and what is not differentiated through Simpson's weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.filters import Floats, difference, kept, low_pass, simpson
from diagnosis.prediction import Prediction
from diagnosis.stretch import Stretch
from dynamics.vehicle import GRAVITY

KINDS = ("imu", "mocap", "angular", "attitude_rate")
UNITS = {"imu": "m/s^2", "mocap": "m/s^2", "angular": "rad/s^2", "attitude_rate": "rad/s"}
AXES = 3
CHANNELS = len(KINDS) * AXES


def present(stretch: Stretch) -> tuple[bool, ...]:
    """Which kinds a stretch has. Without a gyro the angular acceleration is that of the attitude."""
    return (stretch.specific_force is not None, True, True, stretch.gyro is not None)


def measured(stretch: Stretch) -> Floats:
    """(m, 12) what was measured, after the filter; zero where a kind is missing."""
    rate, rows = stretch.rate, kept(len(stretch), stretch.rate)
    nothing = np.zeros((len(stretch), 3))
    force = nothing if stretch.specific_force is None else low_pass(simpson(stretch.specific_force), rate)
    world = low_pass(difference(stretch.velocity, rate), rate) + np.array([0.0, 0.0, GRAVITY])
    angular = low_pass(difference(stretch.body_rate, rate), rate)
    turning = nothing if stretch.gyro is None else low_pass(stretch.turning, rate)
    return np.hstack([force[rows], _into_body(stretch, world)[rows], angular[rows], turning[rows]])


def predicted(stretch: Stretch, predictions: Sequence[Prediction]) -> Floats:
    """(m, 12, k) what k predictions, or k slopes of one, say of the same channels."""
    count, rate, rows = len(stretch), stretch.rate, kept(len(stretch), stretch.rate)
    raw = np.zeros((count, CHANNELS, len(predictions)))
    here = present(stretch)
    for k, prediction in enumerate(predictions):
        raw[:, 0:3, k] = prediction.specific_force if here[0] else 0.0
        raw[:, 3:6, k] = prediction.world_acceleration(stretch)
        raw[:, 6:9, k] = prediction.angular_acceleration
        raw[:, 9:12, k] = prediction.attitude_rate(stretch) if here[3] else 0.0
    active = np.any(raw, axis=0)
    result = np.zeros((len(range(count)[rows]), CHANNELS, len(predictions)))
    result[:, active] = low_pass(simpson(raw[:, active]), rate)[rows]
    result[:, 3:6] = np.einsum("nji,njk->nik", stretch.to_world[rows], result[:, 3:6])
    return result


def residual(stretch: Stretch, prediction: Prediction) -> Floats:
    """(m, 12) measured less predicted."""
    return measured(stretch) - predicted(stretch, [prediction])[:, :, 0]


def _into_body(stretch: Stretch, world: Floats) -> Floats:
    return np.asarray(np.einsum("nji,nj->ni", stretch.to_world, world))


def norms(residuals: Sequence[Floats]) -> dict[str, float]:
    """RMS norm over the three axes of each kind, over all residuals (m, 12)."""
    rows = np.vstack(residuals)
    return {
        kind: float(np.sqrt(np.mean(np.sum(rows[:, 3 * i : 3 * i + 3] ** 2, axis=1)))) for i, kind in enumerate(KINDS)
    }
