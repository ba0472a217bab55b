"""Errors-in-variables correction: the sensors' noise is in the columns too, and biases coefficients.

A segment with noise of the same level added is evaluated once more; the change of the normal equations is, to first
order, the bias that the sensors' noise had caused in them (SIMEX).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.models.pose_errors import velocity_error
from diagnosis.selection.design_matrix import DesignMatrix
from diagnosis.thresholds import DEFAULT, PoseThresholds
from dynamics import quaternion
from dynamics.arrays import Floats

SEED = 1  # of the added noise, so that the same flights have the same answer


def noisier_segments(segments: Sequence[Segment], pose: PoseThresholds = DEFAULT.pose) -> list[Segment]:
    """Each segment with noise added, the same whenever it is called."""
    random = np.random.default_rng(SEED)
    return [perturbed(segment, random, pose) for segment in segments]


def design_errors(
    noisier: Sequence[Segment], design: DesignMatrix, rows: Sequence[Floats], columns: Sequence[Floats]
) -> Iterator[tuple[Floats, Floats]]:
    """(m, 12) and (m, 12, k) changes of each segment's rows and columns by added noise.

    What they add to X'X and X'y is what the sensors' noise has added already.
    noisier: segments with noise added. rows, columns: (m, 12) and (m, 12, k) without it, as the design evaluates them.
    """
    for segment, y, x in zip(noisier, rows, columns, strict=True):
        noisier_y, noisier_x = design.evaluate(segment)
        yield noisier_y - y, noisier_x - x


def perturbed(segment: Segment, random: np.random.Generator, pose: PoseThresholds = DEFAULT.pose) -> Segment:
    """The segment with white noise of its sensors' estimated levels added, and an estimator's slow error of velocity.

    pose: size and correlation time of the latter.
    """

    def noisier(values: Floats) -> Floats:
        return values + white_level(values) * random.standard_normal(values.shape)

    attitude = segment.attitude
    step = quaternion.logarithm(quaternion.multiply(quaternion.conjugate(attitude[:-1]), attitude[1:]))
    level = float(np.std(np.diff(step, 2, axis=0))) / np.sqrt(20.0)
    turned = quaternion.multiply(attitude, quaternion.exponential(level * random.standard_normal((len(segment), 3))))
    velocity = noisier(segment.velocity)
    if segment.pose_source == "estimator":
        velocity = velocity + velocity_error(segment, random, pose)
    return replace(
        segment,
        position=noisier(segment.position),
        velocity=velocity,
        attitude=np.asarray(turned),
        gyro=None if segment.gyro is None else noisier(segment.gyro),
        specific_force=None if segment.specific_force is None else noisier(segment.specific_force),
        rotor_speed=noisier(segment.rotor_speed) if segment.rotor_source == "measured" else segment.rotor_speed,
    )


def white_level(values: Floats) -> float:
    """Standard deviation of white noise in smooth signals (n, k), from third differences."""
    return float(np.std(np.diff(values, 3, axis=0), axis=0).mean() / np.sqrt(20.0))
