"""Is something left that no effect of the catalogue explains?

Three looks at what the fitted model leaves on flights: forces that accelerometer and pose agree on at low frequency,
what any smooth function of the state could still bring, and lines in the spectrum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from diagnosis.data.filters import kept
from diagnosis.data.segment import Segment
from diagnosis.selection.noise import NoiseModel
from diagnosis.selection.regression import Regression
from dynamics.arrays import Floats

FEATURES = 120
SMOOTH, FINE = 0.35, 1.5  # of a feature's direction, over the standard deviation of what it depends on
RIDGES = (1e2, 1e3, 1e4, 1e5)
LINE = (0.6, 7.0)  # Hz
SPECTRUM = 512


@dataclass(frozen=True)
class Leftover:
    """Measures of what a model leaves.

    agreement: low-frequency power common to accelerometer and pose, or of torque, over that at mid frequencies.
    learnable: twice the log-likelihood that a function of the state brings on flights left out, over the number of
    whitened residuals. line: greatest narrow-band power over its surroundings. returning: the same share as learnable,
    of what comes back at the same places within a flight; 0 where nobody asked.
    """

    agreement: float
    learnable: float
    line: float
    returning: float = 0.0


def look(regression: Regression, rows: Sequence[Floats], *, places: bool = False) -> Leftover:
    """What is left in residuals (m, 12) of the regression's segments.

    places: whether to ask what comes back at the same places, which a gust does not.
    """
    total = max(regression.total, 1)
    states = [_state(s) for s in regression.segments]
    learnable = _learnable(regression, _features(states, SMOOTH), rows, regression.flight_of) / total
    returning = 0.0
    if places:
        spots = [_place(s) for s in regression.segments]
        halves = [_halves(x) for x in _features(spots, FINE)], [_halves(r) for r in rows]
        features, parts = ([half for pair in found for half in pair] for found in halves)
        returning = _learnable(regression, features, parts, range(len(parts))) / total
    return Leftover(_agreement(rows, regression.rate), learnable, _line(rows, regression.rate), returning)


def _agreement(rows: Sequence[Floats], rate: float) -> float:
    low, mid, size = np.zeros(6), np.zeros(6), np.zeros(6)
    count_low = count_mid = 0
    for r in rows:
        waves = np.fft.rfft(r * np.hanning(len(r))[:, None], axis=0)
        frequency = np.fft.rfftfreq(len(r), 1 / rate)
        common = np.real(waves[:, 0:3] * np.conj(waves[:, 3:6]))
        torque = np.abs(waves[:, 6:9]) ** 2
        power = np.hstack([common, torque])
        own = np.hstack([np.abs(waves[:, 0:3]) * np.abs(waves[:, 3:6]), torque])
        below, between = (frequency > 0.05) & (frequency < 1.5), (frequency > 2.5) & (frequency < 6.5)
        low, mid, size = low + power[below].sum(0), mid + power[between].sum(0), size + own[between].sum(0)
        count_low, count_mid = count_low + int(below.sum()), count_mid + int(between.sum())
    low, mid, size = low / count_low, mid / count_mid, np.maximum(size / count_mid, 1e-30)
    force = (low[:3] - np.maximum(mid[:3], 0)) / size[:3]
    return float(np.max(np.concatenate([force, low[3:] / np.maximum(mid[3:], 1e-30)])))


def _features(states: Sequence[Floats], fineness: float) -> list[Floats]:
    """Random Fourier features of states (m, k), and the states themselves."""
    everything = np.vstack(states)
    mean, deviation = everything.mean(axis=0), everything.std(axis=0) + 1e-9
    random = np.random.default_rng(0)
    directions = fineness * random.standard_normal((everything.shape[1], FEATURES))
    phase = random.uniform(0, 2 * np.pi, FEATURES)
    scaled = [(state - mean) / deviation for state in states]
    return [np.hstack([np.cos(z @ directions + phase), z, np.ones((len(z), 1))]) for z in scaled]


def _halves(rows: Floats) -> tuple[Floats, Floats]:
    return rows[: len(rows) // 2], rows[len(rows) // 2 :]


def _learnable(
    regression: Regression, features: Sequence[Floats], rows: Sequence[Floats], group_of: Sequence[int]
) -> float:
    """Gain of features (m, k) in residuals (m, 12), leaving one group out, summed over channels."""
    total = 0.0
    for place, channel in enumerate(regression.noise.active):
        if channel >= 9:
            continue
        grams, products = _per_group(regression.noise, features, rows, group_of, place, channel)
        total += max(0.0, *(_crossed(grams, products, ridge) for ridge in RIDGES))
    return total


def _per_group(
    noise: NoiseModel, features: Sequence[Floats], rows: Sequence[Floats], group_of: Sequence[int], place: int,
    channel: int,
) -> tuple[list[Floats], list[Floats]]:  # fmt: skip
    width, count = features[0].shape[1], max(group_of) + 1
    grams, products = [np.zeros((width, width)) for _ in range(count)], [np.zeros(width) for _ in range(count)]
    for x, y, group in zip(features, rows, group_of, strict=True):
        white_x = noise.whiten_one(place, x)
        grams[group] += white_x.T @ white_x
        products[group] += white_x.T @ noise.whiten_one(place, y[:, channel])
    return grams, products


def _crossed(grams: Sequence[Floats], products: Sequence[Floats], ridge: float) -> float:
    all_gram, all_product = sum(grams), sum(products)
    gain = 0.0
    for gram, product in zip(grams, products, strict=True):
        theta = np.linalg.solve(all_gram - gram + ridge * np.eye(len(gram)), all_product - product)
        gain += float(2 * theta @ product - theta @ gram @ theta)
    return gain


def _state(segment: Segment) -> Floats:
    """(m, k) what a missing force may depend on."""
    velocity = np.einsum("nji,nj->ni", segment.to_world, segment.smooth[:, 3:6])
    squares = segment.rotor_speed**2
    parts = [velocity, segment.smooth[:, 10:13], squares, segment.to_world[:, 2, :], segment.smooth[:, 0:3]]
    return np.hstack(parts)[kept(len(segment), segment.rate)]


def _place(segment: Segment) -> Floats:
    """(m, 3) where the vehicle is."""
    return segment.smooth[kept(len(segment), segment.rate), 0:3]


def _line(rows: Sequence[Floats], rate: float) -> float:
    power = np.zeros((SPECTRUM // 2 + 1, 9))
    for r in rows:
        power += np.abs(np.fft.rfft(r[:, :9] * np.hanning(len(r))[:, None], SPECTRUM, axis=0)) ** 2
    frequency = np.fft.rfftfreq(SPECTRUM, 1 / rate)
    around = np.maximum(median_filter(power, size=(61, 1), mode="nearest"), 1e-12)
    return float((power / around)[(frequency > LINE[0]) & (frequency < LINE[1])].max())
