"""Random air motion with a gust's spectrum: the strength at which the residuals are most likely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.selection.regression import Regression
from diagnosis.thresholds import GustThresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect


@dataclass(frozen=True)
class Gust:
    """A gust as far as flights show it.

    gain: twice the log-likelihood gained.
    score: the gain less its penalty.
    intensity: m/s, through the usual rotor drag.
    effect: the catalogue's stochastic effect; None where it holds none, or no wind to regress.
    """

    gain: float
    score: float
    intensity: float
    effect: Effect | None = None


def gust_gain(regression: Regression, chosen: Sequence[int]) -> Gust:
    """A random-effects likelihood of one strength, maximised over it, on the residuals after the chosen columns."""
    thresholds = regression.thresholds.gust
    wind = next((c for c in regression.candidates if c.effect.wind is not None), None)
    effect = next((e for e in regression.catalogue.values() if e.stochastic and e.wind is not None), None)
    if wind is None or effect is None:
        return Gust(0.0, -np.inf, 0.0)
    parts: list[tuple[Floats, Floats]] = []
    residuals = regression.residuals_after(chosen)
    for rows, columns in zip(residuals, regression.columns, strict=True):
        basis, weight = _cosines(len(rows), regression.rate, thresholds)
        waves = columns[:, :, list(wind.columns), None] * basis[:, None, None, :]
        white = regression.noise.whiten(waves.reshape(len(rows), rows.shape[1], -1))
        white = white * np.sqrt(np.tile(weight, len(wind.columns)))
        flat = white.reshape(-1, white.shape[2])
        parts.append((flat.T @ flat, flat.T @ regression.noise.whiten(rows).ravel()))
    scale = float(np.mean([np.trace(gram) / len(gram) for gram, _ in parts]))
    if scale <= 0:
        return Gust(0.0, -np.inf, 0.0)
    gain, variance = _best_strength(parts, np.geomspace(1e-3, 1e6, thresholds.strengths) / scale)
    penalty = np.log(regression.independent) + 2 * np.log(thresholds.strengths)
    _, weight = _cosines(len(residuals[0]), regression.rate, thresholds)
    return Gust(gain, gain - float(penalty), float(np.sqrt(variance * weight.sum() / 2)), effect)


def _best_strength(parts: Sequence[tuple[Floats, Floats]], variances: Floats) -> tuple[float, float]:
    """Twice the greatest log-likelihood gained, and the variance of the amplitudes there; zeros where none gains.

    parts: normal equations (k, k) and (k,) of each segment's amplitudes.
    """
    eigen = [(values, vectors.T @ product) for (gram, product) in parts for values, vectors in [np.linalg.eigh(gram)]]
    best = (0.0, 0.0)
    for variance in variances:
        gain = 0.0
        for values, product in eigen:
            inverse = 1 / (1 + variance * np.maximum(values, 0.0))
            gain += variance * float(np.sum(product**2 * inverse)) + float(np.sum(np.log(inverse)))
        if gain > best[0]:
            best = (gain, float(variance))
    return best


def _cosines(count: int, rate: float, thresholds: GustThresholds) -> tuple[Floats, Floats]:
    """(m, k) half-wave cosines, and the weight (k,) that a gust's spectrum gives to each."""
    duration = count / rate
    order = np.arange(int(2 * duration * thresholds.max_frequency) + 1)
    basis = np.cos(np.pi * np.outer((np.arange(count) + 0.5) / count, order))
    weight = np.where(order == 0, 0.5, 1.0) / (1 + (order / (2 * duration) / thresholds.corner) ** 2)
    return basis, weight
