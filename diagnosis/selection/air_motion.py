"""Random air motion as a nuisance: half-wave cosines of air velocity, a random effect of one strength, marginalised.

The cosines act through the regressors of a steady wind. Segments are cut into parts, whose cosines are independent.
Their products with rows and columns are kept along the eigenvectors of their own Gram matrix, so that the normal
equations beside a gust of any strength are a few products.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.selection.noise import NoiseModel
from diagnosis.thresholds import GustThresholds
from dynamics.arrays import Floats
from dynamics.effects.gust import VERTICAL_SHARE


@dataclass(frozen=True, eq=False)
class Whitened:
    """A segment's whitened columns (m, c, k) and rows (m, c), and the errors of both that sensors' noise causes."""

    columns: Floats
    rows: Floats
    column_errors: Floats
    row_errors: Floats

    def flat(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Rows with time and channels in one axis: (m c, k), (m c,), twice."""
        width = self.columns.shape[2]
        return (
            self.columns.reshape(-1, width),
            self.rows.ravel(),
            self.column_errors.reshape(-1, width),
            self.row_errors.ravel(),
        )


@dataclass(frozen=True, eq=False)
class Waves:
    """One flight's cosines along the eigenvectors of their whitened Gram matrix, and what they share with the rest.

    eigenvalues: (w,) of the cosines, each weighted by a gust's spectrum, 1/(m/s)^2.
    columns, rows: (k, w) and (w,) their products with the whitened columns and rows.
    column_errors, row_errors: the same with the errors in these that noise added to the segments causes.
    """

    eigenvalues: Floats
    columns: Floats
    rows: Floats
    column_errors: Floats
    row_errors: Floats

    def reduction(self, variance: Floats, places: Sequence[int], *, corrected: bool) -> tuple[Floats, Floats]:
        """(.., p, p) and (.., p) what gusts of variances (..) take off the normal equations of the columns at places.

        corrected: whether errors in variables are taken off.
        """
        weight = variance[..., None] / (1 + variance[..., None] * self.eigenvalues)
        x = self.columns[places]
        gram, product = (x * weight[..., None, :]) @ x.T, (weight * self.rows) @ x.T
        if corrected:
            e = self.column_errors[places]
            gram = gram - (e * weight[..., None, :]) @ e.T
            product = product - (weight * self.row_errors) @ e.T
        return gram, product

    def gain(self, variance: Floats) -> Floats:
        """(..) twice the log-likelihood that gusts of variances (..) gain in the rows, without any column."""
        grown = 1 + variance[..., None] * self.eigenvalues
        return np.asarray(np.sum(variance[..., None] / grown * self.rows**2, axis=-1) - np.sum(np.log(grown), axis=-1))


def make_waves(
    segments: Sequence[Whitened],
    wind: Sequence[Floats],
    noise: NoiseModel,
    rate: float,
    thresholds: GustThresholds,
) -> tuple[Waves, ...]:
    """The waves of one flight, with the usual corner of a gust's spectrum and with each other one.

    wind: (m + order, 12, a) regressors of a steady wind along world x, y and perhaps z, a segment each, per m/s.
    """
    parts = [
        part for one, air in zip(segments, wind, strict=True) for part in _parts(one, air, noise, rate, thresholds)
    ]
    return tuple(_joined(of_corner) for of_corner in zip(*parts, strict=True))


def _joined(parts: Sequence[Waves]) -> Waves:
    return Waves(
        np.concatenate([part.eigenvalues for part in parts]),
        np.concatenate([part.columns for part in parts], axis=1),
        np.concatenate([part.rows for part in parts]),
        np.concatenate([part.column_errors for part in parts], axis=1),
        np.concatenate([part.row_errors for part in parts]),
    )


def _parts(
    segment: Whitened, wind: Floats, noise: NoiseModel, rate: float, thresholds: GustThresholds
) -> Iterator[tuple[Waves, ...]]:
    """The waves of each part of a segment, a set for each corner."""
    count = len(segment.rows)
    edges = np.linspace(0, count, max(1, round(count / (thresholds.part * rate))) + 1).astype(int).tolist()
    for start, stop in itertools.pairwise(edges):
        air = wind[start : stop + noise.order] * np.array([1.0, 1.0, VERTICAL_SHARE])[: wind.shape[2]]
        basis = cosines(len(air), rate, thresholds)
        waves = air[:, :, :, None] * basis[:, None, None, :]
        flat = noise.whiten(waves.reshape(*air.shape[:2], -1)).reshape(-1, air.shape[2] * basis.shape[1])
        here = slice(start, stop)
        part = Whitened(
            segment.columns[here], segment.rows[here], segment.column_errors[here], segment.row_errors[here]
        )
        gram, products = flat.T @ flat, [flat.T @ of for of in part.flat()]
        weights = [spectral_weights(len(air), rate, corner, thresholds) for corner in thresholds.corners]
        yield tuple(_with_spectrum(gram, products, np.tile(weight, air.shape[2])) for weight in weights)


def _with_spectrum(gram: Floats, products: Sequence[Floats], weight: Floats) -> Waves:
    """Waves whose amplitudes have the variances `weight`, from the products of those of unit variance."""
    size = np.sqrt(weight)
    values, vectors = np.linalg.eigh(size[:, None] * gram * size)
    turned = size[:, None] * vectors
    x, y, x_error, y_error = products
    return Waves(np.maximum(values, 0.0), x.T @ turned, turned.T @ y, x_error.T @ turned, turned.T @ y_error)


def cosines(count: int, rate: float, thresholds: GustThresholds) -> Floats:
    """(m, k) half-wave cosines up to the highest frequency."""
    order = np.arange(int(2 * count / rate * thresholds.max_frequency) + 1)
    return np.asarray(np.cos(np.pi * np.outer((np.arange(count) + 0.5) / count, order)))


def spectral_weights(count: int, rate: float, corner: float, thresholds: GustThresholds) -> Floats:
    """(k,) variances of the cosines' amplitudes in air of variance 1, part of which is above the highest frequency.

    Its spectrum is of first order with this corner, Hz: what is below f has the share 2/pi arctan(f / corner).
    """
    duration = count / rate
    order = np.arange(int(2 * duration * thresholds.max_frequency) + 1)
    share = np.where(order == 0, 1.0, 0.5)  # mean square of each cosine
    weight = np.where(order == 0, 0.5, 1.0) / (1 + (order / (2 * duration) / corner) ** 2)
    below = 2 / np.pi * np.arctan(thresholds.max_frequency / corner)
    return np.asarray(below * weight / float(weight @ share))
