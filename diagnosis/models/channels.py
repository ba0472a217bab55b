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

from diagnosis.data.filters import difference, kept, low_pass, simpson
from diagnosis.data.segment import Segment
from diagnosis.models.prediction import Prediction
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY

KINDS = ("imu", "mocap", "angular", "attitude_rate")
UNITS = {"imu": "m/s^2", "mocap": "m/s^2", "angular": "rad/s^2", "attitude_rate": "rad/s"}
AXES = 3
CHANNELS = len(KINDS) * AXES


def present(segment: Segment) -> tuple[bool, ...]:
    """Which kinds a segment has. Without a gyro the angular acceleration is that of the attitude."""
    gyro = segment.gyro is not None
    return (segment.specific_force is not None, segment.has_pose, True, gyro and segment.has_attitude)


def measured(segment: Segment) -> Floats:
    """(m, 12) what was measured, after the filter; zero where a kind is missing."""
    rate, rows = segment.rate, kept(len(segment), segment.rate)
    nothing = np.zeros((len(segment), 3))
    _, posed, _, turns = present(segment)
    force = nothing if segment.specific_force is None else low_pass(simpson(segment.specific_force), rate)
    world = low_pass(difference(segment.velocity, rate), rate) + np.array([0.0, 0.0, GRAVITY])
    felt = _into_body(segment, world) if posed else nothing
    angular = low_pass(difference(segment.body_rate, rate), rate)
    turning = low_pass(segment.turning, rate) if turns else nothing
    return np.hstack([force[rows], felt[rows], angular[rows], turning[rows]])


def predicted(segment: Segment, predictions: Sequence[Prediction]) -> Floats:
    """(m, 12, k) what k predictions, or k slopes of one, say of the same channels."""
    count, rate, rows = len(segment), segment.rate, kept(len(segment), segment.rate)
    raw = np.zeros((len(predictions), CHANNELS, count))
    here = present(segment)
    for prediction, channel in zip(predictions, raw, strict=True):
        if here[0]:
            channel[0:3] = prediction.specific_force.T
        if here[1]:
            channel[3:6] = prediction.world_acceleration(segment).T
        channel[6:9] = prediction.angular_acceleration.T
        if here[3]:
            channel[9:12] = prediction.attitude_rate(segment).T
    active = np.any(raw, axis=2)
    filtered = low_pass(simpson(raw[active].T), rate)[rows]
    result = np.zeros((len(filtered), CHANNELS, len(predictions)))
    result.transpose(2, 1, 0)[active] = filtered.T
    result[:, 3:6] = np.einsum("nji,njk->nik", segment.to_world[rows], result[:, 3:6])
    return result


def residual(segment: Segment, prediction: Prediction) -> Floats:
    """(m, 12) measured less predicted."""
    return measured(segment) - predicted(segment, [prediction])[:, :, 0]


def _into_body(segment: Segment, world: Floats) -> Floats:
    return np.asarray(np.einsum("nji,nj->ni", segment.to_world, world))


def norms(residuals: Sequence[Floats]) -> dict[str, float]:
    """RMS norm over the three axes of each kind, over all residuals (m, 12)."""
    rows = np.vstack(residuals)
    return {
        kind: float(np.sqrt(np.mean(np.sum(rows[:, 3 * i : 3 * i + 3] ** 2, axis=1)))) for i, kind in enumerate(KINDS)
    }
