"""Errors of an estimator's pose, as they enter the residuals.

An estimator that used the accelerometer errs slowly and smoothly, by far more than its noise from sample to sample
shows. Its error of velocity is, to the model, air that moves, and its derivative is in the acceleration of the pose;
its error of tilt turns gravity. Motion capture has no such errors, and where the source is unknown none are allowed
for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.models.predictor import Predictor
from diagnosis.thresholds import DEFAULT, PoseThresholds
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Contribution of the pose's errors to the residuals.

    slopes: (12,) of the channels in an error of velocity, RMS over its three axes, 1/s or 1/(s m); None where the pose
        has no errors of its own.
    velocity: standard deviation of that error, m/s.
    """

    slopes: Floats | None
    velocity: float = 0.0
    thresholds: PoseThresholds = DEFAULT.pose

    @property
    def there(self) -> bool:
        """Whether the pose has such errors."""
        return self.slopes is not None

    def density(self, frequency: Floats) -> Floats:
        """(12, f) two-sided power density of these errors in each channel at frequencies, Hz."""
        if self.slopes is None:
            return np.zeros((channels.CHANNELS, len(frequency)))
        limits = self.thresholds
        velocity = self.velocity**2 * _shape(frequency, limits.velocity_time, limits.smooth_time)
        tilt = limits.tilt_error**2 * _shape(frequency, limits.tilt_time, limits.smooth_time)
        squared = (2 * np.pi * frequency) ** 2
        density = self.slopes[:, None] ** 2 * velocity
        density[channels.POSE_ACCELERATION] += squared * velocity + GRAVITY**2 * tilt
        density[channels.ATTITUDE_RATE] += squared * tilt
        return np.asarray(density)


NO_ERRORS = PoseErrors(None)


def pose_errors(
    segments: Sequence[Segment], predictor: Predictor, thresholds: PoseThresholds = DEFAULT.pose
) -> PoseErrors:
    """The errors of these segments' pose; predictor: of the present model, for its slopes in the velocity."""
    estimated = [segment for segment in segments if segment.pose_source == "estimator"]
    if not estimated:
        return NO_ERRORS
    velocity = float(np.sqrt(np.mean([velocity_disagreement(s, thresholds) ** 2 for s in estimated])))
    squares = [_squared_slopes(segment, predictor, thresholds) for segment in segments[: thresholds.examples]]
    return PoseErrors(np.sqrt(np.mean(squares, axis=0)), velocity, thresholds)


def with_velocity_errors(
    segments: Sequence[Segment], random: np.random.Generator, thresholds: PoseThresholds = DEFAULT.pose
) -> list[Segment]:
    """Segments with an error of velocity as large as their own added to it."""
    return [replace(s, velocity=s.velocity + velocity_error(s, random, thresholds), without_noise=s) for s in segments]


def certain_error(segment: Segment, random: np.random.Generator, thresholds: PoseThresholds = DEFAULT.pose) -> Floats:
    """(n, 3) a draw of the part of a segment's error of velocity that is taken off what it does to estimates, m/s.

    Its size and times are known by about a half. What is taken off too little biases an estimate by less than its
    deviation; what is taken off too much leaves nothing of columns that depend on the velocity, and makes up others.
    """
    return np.asarray(np.sqrt(thresholds.certain) * velocity_error(segment, random, thresholds))


def velocity_error(segment: Segment, random: np.random.Generator, thresholds: PoseThresholds = DEFAULT.pose) -> Floats:
    """(n, 3) a draw of the error of a segment's velocity, m/s."""
    shares = [np.exp(-1 / (segment.rate * time)) for time in (thresholds.velocity_time, thresholds.smooth_time)]
    before = round(5 * segment.rate * thresholds.velocity_time)  # until it is stationary
    a, b = shares
    variance = (1 + a * b) / ((1 - a * b) * (1 - a * a) * (1 - b * b))
    white = random.standard_normal((before + len(segment), 3))
    error = scipy.signal.lfilter([1.0], [1.0, -(a + b), a * b], white, axis=0)[before:]
    return np.asarray(velocity_disagreement(segment, thresholds) * error / np.sqrt(variance))


def velocity_disagreement(segment: Segment, thresholds: PoseThresholds = DEFAULT.pose) -> float:
    """Size of the velocity's error in one segment, m/s: by how much it is not the derivative of the position.

    An estimator corrects both separately, so that their disagreement is about as large as the error of either. It
    counts up to the thresholds' error, which is assumed where no position was logged.
    """
    count = max(1, round(thresholds.smooth_time * segment.rate))
    if "position" in segment.lacks or "velocity" in segment.lacks or len(segment) <= count:
        return thresholds.velocity_error
    travelled = (segment.position[count:] - segment.position[:-count]) * (segment.rate / count)
    passed = np.vstack([np.zeros((1, 3)), np.cumsum((segment.velocity[1:] + segment.velocity[:-1]) / 2, axis=0)])
    difference = travelled - (passed[count:] - passed[:-count]) / count
    return float(min(thresholds.velocity_error, np.sqrt(np.mean(difference**2))))


def _squared_slopes(segment: Segment, predictor: Predictor, thresholds: PoseThresholds) -> Floats:
    """(12,) mean square of the change of each channel with the velocity, summed over axes."""
    here = channels.predicted(segment, [predictor.predict(segment)])[:, :, 0]
    total, step = np.zeros(channels.CHANNELS), thresholds.velocity_error
    for axis in np.eye(channels.AXES):
        moved = replace(segment, velocity=segment.velocity + step * axis)
        change = channels.predicted(moved, [predictor.predict(moved)])[:, :, 0] - here
        total += np.mean((change / step) ** 2, axis=0)
    return total


def _shape(frequency: Floats, time: float, smooth: float) -> Floats:
    """Two-sided density of a Gauss-Markov process of second order with unit variance. time, smooth: s."""
    omega = 2 * np.pi * frequency
    return np.asarray(2 * (time + smooth) / ((1 + (omega * time) ** 2) * (1 + (omega * smooth) ** 2)))
