"""Errors of an estimator's pose, as they enter the residuals.

An estimator that used the accelerometer errs slowly and smoothly, by far more than its noise from sample to sample
shows. Its error of velocity is, to the model, air that moves, and its derivative is in the acceleration of the pose;
its error of tilt turns gravity. Motion capture has no such errors, and where the source is unknown none are allowed
for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from diagnosis.data.segment import Segment
from diagnosis.thresholds import DEFAULT, PoseThresholds
from dynamics.arrays import Floats


def with_velocity_errors(
    segments: Sequence[Segment], random: np.random.Generator, thresholds: PoseThresholds = DEFAULT.pose
) -> list[Segment]:
    """Segments with an error of velocity as large as their own added to it."""
    return [replace(s, velocity=s.velocity + velocity_error(s, random, thresholds), without_noise=s) for s in segments]


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
