"""Exact log-likelihood of rows by a plain Kalman filter, for checks of components: clear, not fast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from diagnosis.noise.discretisation import DiscreteModel
from dynamics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Filtered:
    """Log-likelihood of rows, and their innovations.

    whitened: (rows, m) of unit variance where the model is true; NaN where a reading is missing.
    """

    log_likelihood: float
    whitened: Floats


def filter_rows(model: DiscreteModel, start: Floats, readings: Floats) -> Filtered:
    """Kalman filter in one-step form, w and v correlated (Anderson and Moore, Optimal Filtering, 1979).

    start: (n, n) covariance of the states one period before the first row, about zero. readings: (rows, m), NaN where
    one is missing.
    """
    state, P, whitened, total = np.zeros(len(model.A)), start, np.full(readings.shape, np.nan), 0.0
    for row, reading in enumerate(readings):
        present = np.isfinite(reading)
        C, S, R = model.C[present], model.S[:, present], model.R[np.ix_(present, present)]
        cholesky = np.linalg.cholesky(C @ P @ C.T + R)
        scaled = scipy.linalg.solve_triangular(cholesky, reading[present] - C @ state, lower=True)
        gain = scipy.linalg.solve_triangular(cholesky, (model.A @ P @ C.T + S).T, lower=True).T
        total -= np.log(np.diag(cholesky)).sum() + (scaled @ scaled + present.sum() * np.log(2 * np.pi)) / 2
        whitened[row, present] = scaled
        state = model.A @ state + gain @ scaled
        P = model.A @ P @ model.A.T + model.Q - gain @ gain.T
        P = (P + P.T) / 2
    return Filtered(float(total), whitened)
