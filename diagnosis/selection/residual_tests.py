"""Tests of an identified model's residuals: do they contain more than noise?

Force on which accelerometer and pose agree at low frequency, what a smooth function of state or position predicts, and
lines in the spectrum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from diagnosis.data.segment import Segment
from diagnosis.models.channels import ANGULAR_ACCELERATION, MOTION, POSE_ACCELERATION, SPECIFIC_FORCE
from diagnosis.selection.noise import NoiseModel
from diagnosis.selection.regression import Regression
from diagnosis.thresholds import ResidualTestThresholds
from dynamics.arrays import Floats
from dynamics.state import POSITION, RATE, VELOCITY


@dataclass(frozen=True)
class ResidualTests:
    """Statistics of a model's residuals, near 0 or 1 where they are noise.

    low_frequency_agreement: low-frequency power common to accelerometer and pose, or of torque, over that at mid
        frequencies.
    predictable_from_state: twice the log-likelihood that a function of the state gains on flights left out, over the
        number of whitened residuals.
    spectral_line: greatest narrow-band power over its surroundings.
    position_dependent: as predictable_from_state, from position alone and on the other half of each flight; 0 where it
        was not computed.
    """

    low_frequency_agreement: float
    predictable_from_state: float
    spectral_line: float
    position_dependent: float = 0.0


def run_residual_tests(regression: Regression, rows: Sequence[Floats], *, by_position: bool = False) -> ResidualTests:
    """Tests of residuals (m, 12) of the regression's segments.

    by_position: whether to test what repeats at the same positions, which a gust does not.
    """
    thresholds, total = regression.thresholds.residual_tests, max(regression.total, 1)
    states = [_state(s) for s in regression.segments]
    features = _features(states, thresholds.state_fineness, thresholds.features)
    predictable = _predictable(regression, features, rows, regression.flight_of) / total
    repeating = 0.0
    if by_position:
        positions = [s.smooth[s.decimated, POSITION] for s in regression.segments]
        fine = _features(positions, thresholds.position_fineness, thresholds.features)
        features, parts = ([half for x in whole_flights for half in _halves(x)] for whole_flights in (fine, rows))
        repeating = _predictable(regression, features, parts, range(len(parts))) / total
    return ResidualTests(
        low_frequency_agreement=low_frequency_agreement(rows, regression.rate, thresholds),
        predictable_from_state=predictable,
        spectral_line=spectral_line(rows, regression.rate, thresholds),
        position_dependent=repeating,
    )


def low_frequency_agreement(rows: Sequence[Floats], rate: float, thresholds: ResidualTestThresholds) -> float:
    """Power in the low band over that in the reference band: of the forces' cross spectrum, or of a torque.

    rows: (m, 12) residuals of each segment at rate Hz.
    """
    low, reference, size = np.zeros(6), np.zeros(6), np.zeros(6)
    count_low = count_reference = 0
    for r in rows:
        waves = np.fft.rfft(r * np.hanning(len(r))[:, None], axis=0)
        frequency = np.fft.rfftfreq(len(r), 1 / rate)
        force, pose = waves[:, SPECIFIC_FORCE], waves[:, POSE_ACCELERATION]
        torque = np.abs(waves[:, ANGULAR_ACCELERATION]) ** 2
        power = np.hstack([np.real(force * np.conj(pose)), torque])
        own = np.hstack([np.abs(force) * np.abs(pose), torque])
        below, between = _inside(frequency, thresholds.low_band), _inside(frequency, thresholds.reference_band)
        low, reference = low + power[below].sum(0), reference + power[between].sum(0)
        size = size + own[between].sum(0)
        count_low, count_reference = count_low + int(below.sum()), count_reference + int(between.sum())
    low, reference = low / count_low, reference / count_reference
    size = np.maximum(size / count_reference, 1e-30)
    common = (low[:3] - np.maximum(reference[:3], 0)) / size[:3]
    return float(np.max(np.concatenate([common, low[3:] / np.maximum(reference[3:], 1e-30)])))


def spectral_line(rows: Sequence[Floats], rate: float, thresholds: ResidualTestThresholds) -> float:
    """Greatest power in the line band over the median of its surroundings. rows: (m, 12) residuals at rate Hz."""
    count = thresholds.line_rows
    channels = rows[0][:, MOTION].shape[1]
    power = np.zeros((count // 2 + 1, channels))
    for r in rows:
        power += np.abs(np.fft.rfft(r[:, MOTION] * np.hanning(len(r))[:, None], count, axis=0)) ** 2
    frequency = np.fft.rfftfreq(count, 1 / rate)
    median = median_filter(power, size=(thresholds.line_surroundings, 1), mode="nearest")
    return float((power / np.maximum(median, 1e-12))[_inside(frequency, thresholds.line_band)].max())


def _inside(frequency: NDArray[np.floating], band: tuple[float, float]) -> NDArray[np.bool_]:
    return np.asarray((frequency > band[0]) & (frequency < band[1]))


def _features(states: Sequence[Floats], fineness: float, count: int) -> list[Floats]:
    """Random Fourier features of states (m, k), the scaled states, and a constant."""
    everything = np.vstack(states)
    mean, deviation = everything.mean(axis=0), everything.std(axis=0) + 1e-9
    random = np.random.default_rng(0)
    directions = fineness * random.standard_normal((everything.shape[1], count))
    phase = random.uniform(0, 2 * np.pi, count)
    scaled = [(state - mean) / deviation for state in states]
    return [np.hstack([np.cos(z @ directions + phase), z, np.ones((len(z), 1))]) for z in scaled]


def _halves(rows: Floats) -> tuple[Floats, Floats]:
    return rows[: len(rows) // 2], rows[len(rows) // 2 :]


def _predictable(
    regression: Regression, features: Sequence[Floats], rows: Sequence[Floats], group_of: Sequence[int]
) -> float:
    """Gain of features (m, k) in residuals (m, 12), leaving one group out, summed over channels."""
    total = 0.0
    for place, channel in enumerate(regression.noise.active):
        if channel >= MOTION.stop:
            continue
        values = [r[:, channel] for r in rows]
        grams, products = _per_group(regression.noise, place, features, values, group_of)
        ridges = regression.thresholds.residual_tests.ridges
        total += max(0.0, *(cross_validated_gain(grams, products, ridge) for ridge in ridges))
    return total


def _per_group(
    noise: NoiseModel, place: int, features: Sequence[Floats], values: Sequence[Floats], group_of: Sequence[int]
) -> tuple[list[Floats], list[Floats]]:
    """Whitened normal equations of features (m, k) in values (m,) of the active channel at a place."""
    width, count = features[0].shape[1], max(group_of) + 1
    grams, products = [np.zeros((width, width)) for _ in range(count)], [np.zeros(width) for _ in range(count)]
    for x, y, group in zip(features, values, group_of, strict=True):
        white_x = noise.whiten_one(place, x)
        grams[group] += white_x.T @ white_x
        products[group] += white_x.T @ noise.whiten_one(place, y)
    return grams, products


def cross_validated_gain(grams: Sequence[Floats], products: Sequence[Floats], ridge: float) -> float:
    """Gain on each group with ridge coefficients from the others. grams: (k, k), products: (k,), a group each."""
    all_gram, all_product = sum(grams), sum(products)
    gain = 0.0
    for gram, product in zip(grams, products, strict=True):
        theta = np.linalg.solve(all_gram - gram + ridge * np.eye(len(gram)), all_product - product)
        gain += float(2 * theta @ product - theta @ gram @ theta)
    return gain


def _state(segment: Segment) -> Floats:
    """(m, k) quantities that a missing force may depend on."""
    smooth = segment.smooth
    velocity = np.einsum("nji,nj->ni", segment.to_world, smooth[:, VELOCITY])
    squares = segment.rotor_speed**2
    parts = [velocity, smooth[:, RATE], squares, segment.to_world[:, 2, :], smooth[:, POSITION]]
    return np.hstack(parts)[segment.decimated]
