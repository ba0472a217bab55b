"""Random air motion as one number: how strong a horizontal air with a gust's spectrum makes the data likely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.selection.regression import Regression
from dynamics.arrays import Floats
from dynamics.effect import Effect

HIGHEST, CORNER = 0.7, 0.15  # Hz, of the cosines and of the spectrum
STRENGTHS = 25


@dataclass(frozen=True)
class Gust:
    """How likely random air motion is.

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
    """A random-effects likelihood of one strength, maximised over that strength, on what the chosen columns leave."""
    wind = next((c for c in regression.candidates if c.effect.wind is not None), None)
    effect = next((e for e in regression.catalogue.values() if e.stochastic and e.wind is not None), None)
    if wind is None or effect is None:
        return Gust(0.0, -np.inf, 0.0)
    parts: list[tuple[Floats, Floats]] = []
    left = regression.left_over(chosen)
    for rows, columns in zip(left, regression.columns, strict=True):
        basis, weight = _cosines(len(rows), regression.rate)
        waves = columns[:, :, list(wind.columns), None] * basis[:, None, None, :]
        white = regression.noise.whiten(waves.reshape(len(rows), rows.shape[1], -1))
        white = white * np.sqrt(np.tile(weight, len(wind.columns)))
        flat = white.reshape(-1, white.shape[2])
        parts.append((flat.T @ flat, flat.T @ regression.noise.whiten(rows).ravel()))
    scale = float(np.mean([np.trace(gram) / len(gram) for gram, _ in parts]))
    if scale <= 0:
        return Gust(0.0, -np.inf, 0.0)
    best, strength = 0.0, 0.0
    eigen = [(values, vectors.T @ product) for (gram, product) in parts for values, vectors in [np.linalg.eigh(gram)]]
    for variance in np.geomspace(1e-3, 1e6, STRENGTHS) / scale:
        gain = 0.0
        for values, product in eigen:
            inverse = 1 / (1 + variance * np.maximum(values, 0.0))
            gain += variance * float(np.sum(product**2 * inverse)) + float(np.sum(np.log(inverse)))
        if gain > best:
            best, strength = gain, float(variance)
    penalty = np.log(regression.total / 4) + 2 * np.log(STRENGTHS)
    _, weight = _cosines(len(left[0]), regression.rate)
    return Gust(best, best - float(penalty), float(np.sqrt(strength * weight.sum() / 2)), effect)


def _cosines(count: int, rate: float) -> tuple[Floats, Floats]:
    """(m, k) half-wave cosines up to 0.7 Hz, and the weight (k,) that a gust's spectrum gives to each."""
    duration = count / rate
    order = np.arange(int(2 * duration * HIGHEST) + 1)
    basis = np.cos(np.pi * np.outer((np.arange(count) + 0.5) / count, order))
    weight = np.where(order == 0, 0.5, 1.0) / (1 + (order / (2 * duration) / CORNER) ** 2)
    return basis, weight
