"""The twelve residual channels: four kinds of measurement, three axes each.

imu             specific force of the accelerometer, m/s^2
mocap           acceleration from position or velocity, less gravity, in body axes, m/s^2 (`POSE_ACCELERATION`)
angular         angular acceleration from the gyro, rad/s^2
attitude_rate   body rate from the attitude less the gyro, rad/s

A real force shows alike in imu and mocap, a torque in angular, an accelerometer's bias in imu only, a gyro's in
attitude_rate only, a clock offset in mocap and attitude_rate. All products are formed at the full rate; then both
sides pass one filter, and what is not differentiated also Simpson's weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.data.filters import difference, simpson
from diagnosis.data.segment import Segment
from diagnosis.models.prediction import Prediction
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY

KINDS = ("imu", "mocap", "angular", "attitude_rate")
NAMES = {  # for people; KINDS are the keys of JSON
    "imu": "accelerometer",
    "mocap": "pose acceleration",
    "angular": "angular acceleration",
    "attitude_rate": "attitude rate",
}
UNITS = {"imu": "m/s^2", "mocap": "m/s^2", "angular": "rad/s^2", "attitude_rate": "rad/s"}
AXES = 3
CHANNELS = len(KINDS) * AXES
SPECIFIC_FORCE, POSE_ACCELERATION = slice(0, 3), slice(3, 6)
ANGULAR_ACCELERATION, ATTITUDE_RATE = slice(6, 9), slice(9, 12)
MOTION = slice(0, 9)  # forces and torques: all but the attitude rate, which shows sensors alone


def present(segment: Segment) -> tuple[bool, ...]:
    """Which kinds a segment has. Without a gyro the angular acceleration is that of the attitude."""
    gyro = segment.gyro is not None
    return (segment.specific_force is not None, segment.has_pose, True, gyro and segment.has_attitude)


def measured(segment: Segment) -> Floats:
    """(m, 12) measurements after the filter; zero where a kind is missing."""
    return segment.workspace.get("channels", None, lambda: _filtered_measurements(segment))


def _filtered_measurements(segment: Segment) -> Floats:
    rate, rows = segment.rate, segment.decimated
    has_force, has_pose, _, has_attitude_rate = present(segment)
    result = np.zeros((len(range(*rows.indices(len(segment)))), CHANNELS))
    if has_force and segment.specific_force is not None:
        result[:, SPECIFIC_FORCE] = segment.filtered(segment.specific_force, products=True)
    if has_pose:
        world = segment.filtered(difference(segment.velocity, rate)) + np.array([0.0, 0.0, GRAVITY])
        result[:, POSE_ACCELERATION] = _into_body(segment.to_world[rows], world)
    result[:, ANGULAR_ACCELERATION] = segment.filtered(difference(segment.body_rate, rate))
    if has_attitude_rate:
        result[:, ATTITUDE_RATE] = segment.filtered(segment.rate_from_attitude)
    return result


def predicted(segment: Segment, predictions: Sequence[Prediction], kinds: tuple[bool, ...] | None = None) -> Floats:
    """(m, 12, k) the same channels of k predictions, or of k slopes of one. kinds: by default those of the segment."""
    raw = np.zeros((len(predictions), CHANNELS, len(segment)))
    here = present(segment) if kinds is None else kinds
    for prediction, channel in zip(predictions, raw, strict=True):
        if here[0]:
            channel[SPECIFIC_FORCE] = prediction.specific_force.T
        if here[1]:
            channel[POSE_ACCELERATION] = prediction.world_acceleration(segment).T
        if here[2]:
            channel[ANGULAR_ACCELERATION] = prediction.angular_acceleration.T
        if here[3]:
            channel[ATTITUDE_RATE] = prediction.attitude_rate(segment).T
    active, to_body = np.any(raw, axis=2), segment.to_world[segment.decimated].transpose(0, 2, 1)
    filtered = segment.filtered(raw[active].T, products=True)
    result = np.zeros((len(filtered), CHANNELS, len(predictions)))
    result.transpose(2, 1, 0)[active] = filtered.T
    result[:, POSE_ACCELERATION] = to_body @ result[:, POSE_ACCELERATION]
    return result


def residual(segment: Segment, prediction: Prediction) -> Floats:
    """(m, 12) measured less predicted."""
    return measured(segment) - predicted(segment, [prediction])[:, :, 0]


def unfiltered(segment: Segment, prediction: Prediction) -> Floats:
    """(n, 12) measured less predicted at every row, differentiated, not filtered; zero where a kind is absent."""
    rate, rows = segment.rate, np.zeros((len(segment), CHANNELS))
    has_force, has_pose, _, has_attitude_rate = present(segment)
    if has_force and segment.specific_force is not None:
        rows[:, SPECIFIC_FORCE] = simpson(segment.specific_force - prediction.specific_force)
    if has_pose:
        world = difference(segment.velocity, rate) + np.array([0.0, 0.0, GRAVITY])
        rows[:, POSE_ACCELERATION] = _into_body(
            segment.to_world, world - simpson(prediction.world_acceleration(segment))
        )
    rows[:, ANGULAR_ACCELERATION] = difference(segment.body_rate, rate) - simpson(prediction.angular_acceleration)
    if has_attitude_rate:
        rows[:, ATTITUDE_RATE] = segment.rate_from_attitude - simpson(prediction.attitude_rate(segment))
    return rows


def _into_body(to_world: Floats, world: Floats) -> Floats:
    return np.asarray(np.einsum("nji,nj->ni", to_world, world))


def norms(residuals: Sequence[Floats]) -> dict[str, float]:
    """RMS norm over the three axes of each kind, over all residuals (m, 12)."""
    squares = squared_by_kind(np.vstack(residuals))
    return {kind: float(np.sqrt(np.mean(squares[:, i]))) for i, kind in enumerate(KINDS)}


def channel_name(channel: str) -> str:
    """The name of a kind of channel, or of one with its axis, as "imu x", for people."""
    kind, _, axis = channel.partition(" ")
    return " ".join(filter(None, (NAMES.get(kind, kind), axis)))


def squared_by_kind(values: Floats) -> Floats:
    """(..., 4) squared norm over the three axes of each kind. values: (..., 12)."""
    return np.asarray(np.sum(values.reshape(*values.shape[:-1], len(KINDS), AXES) ** 2, axis=-1))
