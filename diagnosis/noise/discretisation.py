"""Exact discretisation of a linear model over one row of a log."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import scipy

from diagnosis.noise.linear_model import LinearModel
from dynamics.arrays import Floats


@dataclass(frozen=True, eq=False)
class DiscreteModel:
    """x' = A x + w, y' = C x + v over one row; [w; v] has the covariance [[Q, S], [S', R]].

    y' is read at the end of the row, or is the mean over it, so that v holds a part of w.
    """

    A: Floats
    C: Floats
    Q: Floats
    S: Floats
    R: Floats


def discretise(model: LinearModel, period: float, averaged: Collection[str] = ()) -> DiscreteModel:
    """A model over `period` s. averaged: outputs whose rows are means, through states that integrate them.

    Raises ValueError for an unknown output, for an instantaneous one that holds white noise and so has no variance,
    and for a noise without intensity.
    """
    if unknown := set(averaged) - set(model.outputs):
        raise ValueError(f"no outputs {', '.join(sorted(unknown))}; there are {', '.join(model.outputs)}.")
    mean = np.array([name in averaged for name in model.outputs], dtype=bool)
    if np.isnan(model.Qc).any():
        missing = [noise for noise, Qc in zip(model.noises, model.Qc, strict=True) if np.isnan(Qc)]
        raise ValueError(
            f"no component gives the noise {', '.join(missing)}; add the one that is named before the point."
        )
    for name in np.array(model.outputs)[~mean & (np.abs(model.D) @ model.Qc > 0)]:
        raise ValueError(f"{name} holds white noise, whose value at an instant has no variance; name it in averaged.")
    n, count = len(model.states), int(mean.sum())
    F = np.zeros((n + count, n + count))
    F[:n, :n], F[n:, :n] = model.F, model.H[mean]
    A, Q = _over(F, np.vstack([model.L, model.D[mean]]) * np.sqrt(model.Qc), period)
    reading = np.zeros((len(mean), n + count))
    reading[~mean, :n], reading[mean, n:] = model.H[~mean], np.eye(count) / period
    C, S, R = reading @ A[:, :n], Q[:n] @ reading.T, reading @ Q @ reading.T + np.diag(model.R)
    return DiscreteModel(A[:n, :n], C, Q[:n, :n], S, (R + R.T) / 2)


def _over(F: Floats, L: Floats, period: float) -> tuple[Floats, Floats]:
    """A = exp(F h) and Q = integral of exp(F s) L L' exp(F s)' (Van Loan, IEEE Trans. Automatic Control 23(3), 1978).

    Of a step in which no state decays by more than e, doubled until it is whole: exp(-F h) overflows over long ones.
    """
    doublings = int(np.ceil(np.log2(max(float(np.linalg.norm(F, 1)) * period, 1.0))))
    n, step = len(F), period / 2**doublings
    exponential = scipy.linalg.expm(np.block([[-F, L @ L.T], [np.zeros((n, n)), F.T]]) * step)
    A = exponential[n:, n:].T
    Q = A @ exponential[:n, n:]
    for _ in range(doublings):
        A, Q = A @ A, A @ Q @ A.T + Q
    return A, (Q + Q.T) / 2
