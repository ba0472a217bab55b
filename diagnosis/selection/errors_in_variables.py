"""Errors-in-variables correction: the sensors' noise is in the columns too, and biases coefficients.

A segment with noise of the same level added is evaluated once more; the change of the normal equations is, to first
order, the bias that the sensors' noise had caused in them (SIMEX).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from diagnosis.data.segment import Segment
from diagnosis.models.pose_errors import certain_error
from diagnosis.selection.design_matrix import DesignMatrix
from diagnosis.selection.noise import sensors_band, white_density
from diagnosis.thresholds import DEFAULT, NoiseThresholds, PoseThresholds, Thresholds
from dynamics import quaternion
from dynamics.arrays import Floats

SEED = 1  # of the added noise, so that the same flights have the same answer


def noisier_segments(segments: Sequence[Segment], thresholds: Thresholds = DEFAULT) -> list[Segment]:
    """Each segment with noise added, the same whenever it is called."""
    random, levels = np.random.default_rng(SEED), inertial_levels(segments, thresholds.noise)
    return [perturbed(segment, random, levels, thresholds.pose) for segment in segments]


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


@dataclass(frozen=True, eq=False)
class InertialLevels:
    """(3,) standard deviations of white noise as dense as a gyro's, rad/s, and an accelerometer's, m/s^2."""

    gyro: Floats
    specific_force: Floats


def perturbed(
    segment: Segment, random: np.random.Generator, levels: InertialLevels, pose: PoseThresholds = DEFAULT.pose
) -> Segment:
    """The segment with white noise of its sensors' levels added, and an estimator's slow error of velocity.

    pose: size and correlation time of the latter.
    """

    def noisier(values: Floats, level: Floats) -> Floats:
        return values + level * random.standard_normal(values.shape)

    attitude = segment.attitude
    step = quaternion.logarithm(quaternion.multiply(quaternion.conjugate(attitude[:-1]), attitude[1:]))
    level = np.std(np.diff(step, 2, axis=0), axis=0) / np.sqrt(20.0)
    turned = quaternion.multiply(attitude, quaternion.exponential(level * random.standard_normal((len(segment), 3))))
    velocity = noisier(segment.velocity, white_level(segment.velocity))
    if segment.pose_source == "estimator":
        velocity = velocity + certain_error(segment, random, pose)
    speed = segment.rotor_speed
    return replace(
        segment,
        position=noisier(segment.position, white_level(segment.position)),
        velocity=velocity,
        attitude=np.asarray(turned),
        gyro=None if segment.gyro is None else noisier(segment.gyro, levels.gyro),
        specific_force=None
        if segment.specific_force is None
        else noisier(segment.specific_force, levels.specific_force),
        rotor_speed=noisier(speed, white_level(speed)) if segment.rotor_source == "measured" else speed,
        without_noise=segment,
    )


def white_level(values: Floats) -> Floats:
    """(k,) standard deviations of white noise in smooth signals (n, k), from third differences."""
    return np.asarray(np.std(np.diff(values, 3, axis=0), axis=0) / np.sqrt(20.0))


def inertial_levels(segments: Sequence[Segment], thresholds: NoiseThresholds = DEFAULT.noise) -> InertialLevels:
    """The levels of all segments' gyros and accelerometers together; zeros without one.

    Autopilots log means and filtered values, whose noise is densest at low frequencies, so that differences from row to
    row, as `white_level` takes them, show little of it. The density is sought where no motion reaches, and where a
    slow log has no such frequencies the differences must do.
    """
    rate, filters = segments[0].rate, segments[0].filters
    low, high = sensors_band(rate, filters, thresholds)

    def level(parts: Sequence[Floats]) -> Floats:
        long = [x - x.mean(axis=0) for x in parts if len(x) >= thresholds.sensor_rows]
        if not parts:
            return np.zeros(3)
        if not long or high < thresholds.min_sensor_band * low:
            return np.asarray(
                np.sqrt(np.average([white_level(x) ** 2 for x in parts], axis=0, weights=[len(x) for x in parts]))
            )
        return np.sqrt([white_density([x[:, i] for x in long], rate, (low, high), thresholds) * rate for i in range(3)])

    gyros, forces = [s.gyro for s in segments], [s.specific_force for s in segments]
    return InertialLevels(level([x for x in gyros if x is not None]), level([x for x in forces if x is not None]))


def gyro_noise_of_its_own(segments: Sequence[Segment], thresholds: NoiseThresholds = DEFAULT.noise) -> Floats | None:
    """(3,) shares of the gyro's noise that the attitude lacks: 1 of motion capture's, less of an estimator's.

    An attitude that is integrated from the gyro has its noise, so that both agree where no motion reaches. None where
    there is no gyro or pose, or the logs are too slow for such frequencies.
    """
    rate, filters = segments[0].rate, segments[0].filters
    low, high = sensors_band(rate, filters, thresholds)
    long = [s for s in segments if s.gyro is not None and s.has_pose and len(s) >= thresholds.sensor_rows]
    if not long or high < thresholds.min_sensor_band * low:
        return None
    common, own = np.zeros(3), np.zeros(3)
    for segment in long:
        assert segment.gyro is not None
        frequency, cross = scipy.signal.csd(
            segment.gyro, segment.rate_from_attitude, rate, nperseg=thresholds.sensor_rows, axis=0
        )
        _, power = scipy.signal.csd(segment.gyro, segment.gyro, rate, nperseg=thresholds.sensor_rows, axis=0)
        inside = (frequency >= low) & (frequency <= high)
        common += len(segment) * np.real(cross[inside]).sum(axis=0)
        own += len(segment) * np.real(power[inside]).sum(axis=0)
    return np.clip(1 - common / np.maximum(own, 1e-300), 0.0, 1.0)
