"""Slow motion's test of a model: Hansen's (1982) test of the restrictions that its fit does not need.

Turbulence turns the vehicle, its controller answers, and a wrong inertia or thrust constant explains a part of that:
a fit leaves less beside it, also where nothing of it is there. The answer falls with the square of the frequency. Of
motion below 0.75 Hz all columns of the catalogue are instruments: what they explain of a fit's residuals is about as
much as there are of them for the right set, whatever its size, and far more for a set that stands in for another one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from diagnosis.data.filters import slow
from diagnosis.data.segment import Segment
from diagnosis.estimation.fitted import Fit
from diagnosis.estimation.linear_rows import LinearRows
from diagnosis.selection.design_matrix import DesignMatrix
from diagnosis.selection.regression import Regression, solved, unzipped
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle


class SlowMotion:
    """The columns of a regression's catalogue, of slow motion, as instruments. In still air."""

    def __init__(self, regression: Regression) -> None:
        self._regression = regression
        self._places = list(regression.biases.columns)
        self._white, self._errors = [], []
        errors = [np.asarray(x, dtype=float) for _, x in regression.errors]
        for segment, columns, error in zip(regression.segments, regression.columns, errors, strict=True):
            self._white.append(self._whitened(self._slow(segment, columns)))
            self._errors.append(self._whitened(self._slow(segment, error)))
        self._biases = [self._whitened(columns[:, :, self._places]) for columns in regression.columns]
        count, off = self._white[0].shape[1], len(self._places)
        self._inner = [np.diag(regression.biases.information) for _ in regression.flights]
        self._across = [np.zeros((count, off)) for _ in regression.flights]
        gram = np.zeros((count, count))
        for flight, z, error, b in self._parts():
            gram += z.T @ z - error.T @ error
            self._inner[flight] += b.T @ b
            self._across[flight] += z.T @ b
        for inner, across in zip(self._inner, self._across, strict=True):
            gram -= across @ np.linalg.solve(inner, across.T)
        self._roots = _roots(gram, regression.thresholds.slow_motion.min_share)

    @property
    def count(self) -> int:
        """Independent ones, of which noise alone leaves as much (the expectation of J, but for the fitted values)."""
        return len(self._roots)

    def left(self, fitted: Fit, vehicle: Vehicle) -> float:
        """Hansen's J of a fit: what all columns explain of what it leaves at the values that these prefer.

        By one step from the fit's values, which follow from all motion. vehicle: that the effects were added to.
        """
        r, values = self._regression, {f"{key}.{name}": value for (key, name), value in fitted.values.items()}
        linear = LinearRows(r, (*fitted.candidates, *fitted.nuisances), vehicle)
        parts = [linear.at(segment, values) for segment in r.segments]
        noisier = [linear.at(segment, values) for segment in r.noisier]
        white = [self._whitened(np.concatenate([x, y[:, :, None]], axis=2)) for y, x, _ in parts]
        errors = [
            self._whitened(np.concatenate([more_x - x, (more - y)[:, :, None]], axis=2))
            for (y, x, _), (more, more_x, _) in zip(parts, noisier, strict=True)
        ]
        products = self._roots @ self._products(white, errors)
        x, y = products[:, :-1], products[:, -1]
        return float(y @ y - solved(x.T @ x, x.T @ y)[1])

    def regression(self) -> Regression:
        """The regression by instruments, as of one flight: two-stage least squares (Theil, 1953).

        Its columns are those of the rotors' own speeds. Columns for detection have the moments of the motion in their
        place, from which a damping that is missing takes what the rotors do against it.
        """
        r = self._regression
        design = DesignMatrix(
            r.vehicle, r.catalogue, (*r.candidates, *r.nuisances), r.segments[0], r.thresholds.prediction
        )
        rows, columns = unzipped(design.evaluate(segment, instrumented=False) for segment in r.segments)
        errors = [self._whitened(np.asarray(x, dtype=float)) for _, x in r.errors]  # of detection's columns: as large
        across = self._roots @ self._products([self._whitened(x) for x in columns], errors)
        added = [self._whitened(y[:, :, None]) for y, _ in r.errors]
        product = self._roots @ self._products([self._whitened(y[:, :, None]) for y in rows], added)
        return replace(r, gram=[across.T @ across], product=[across.T @ product[:, 0]], observations=[r.total])

    def _parts(self) -> Iterator[tuple[int, Floats, Floats, Floats]]:
        return zip(self._regression.flight_of, self._white, self._errors, self._biases, strict=True)

    def _products(self, white: Sequence[Floats], errors: Sequence[Floats]) -> Floats:
        """(k, p) products of the instruments with white columns (m, p), each flight's biases taken off."""
        width = white[0].shape[1]
        total = np.zeros((len(self._across[0]), width))
        off = [np.zeros((len(self._places), width)) for _ in self._across]
        for (flight, z, z_error, b), x, error in zip(self._parts(), white, errors, strict=True):
            total += z.T @ x - z_error.T @ error
            off[flight] += b.T @ x
        for inner, across, products in zip(self._inner, self._across, off, strict=True):
            total -= across @ np.linalg.solve(inner, products)
        return total

    def _slow(self, segment: Segment, columns: Floats) -> Floats:
        return slow(columns, segment.decimated_rate, self._regression.thresholds.slow_motion.cutoff)

    def _whitened(self, columns: Floats) -> Floats:
        """(m c, k) of columns (m, 12, k)."""
        white = self._regression.noise.whiten(columns)
        return white.reshape(white.shape[0] * white.shape[1], columns.shape[2])


def _roots(gram: Floats, min_share: float) -> Floats:
    """(n, k) R with R'R the inverse of a Gram matrix where that is well-conditioned."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-9))
    values, axes = np.linalg.eigh(gram / np.outer(size, size))
    usable = values > min_share
    return np.asarray((axes[:, usable] / np.sqrt(values[usable])).T / size)
