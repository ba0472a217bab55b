"""Exact discretisation of a linear model over one row of a log."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from diagnosis.noise.linear_model import LinearModel
from dynamics.arrays import Floats

NODES = 6  # of Gauss's quadrature: exact to rounding over such a step


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
    F, reading = _with_means(model, mean, period)
    A, Q = _over(F, np.vstack([model.L, model.D[mean]]) * np.sqrt(model.Qc), period)
    n = len(model.states)
    C, S, R = reading @ A[:, :n], Q[:n] @ reading.T, reading @ Q @ reading.T + np.diag(model.R)
    return DiscreteModel(A[:n, :n], C, Q[:n, :n], S, (R + R.T) / 2)


def covariances(
    model: LinearModel, period: float, averaged: Collection[str], Qc: Floats, R: Floats
) -> list[DiscreteModel]:
    """Covariances over one row by intensities Qc (h, k) of a model's noises and variances R (h, m) of single readings:
    both enter linearly, so that differences of them do as well. A and C are zero.

    By Gauss's quadrature over a step in which no state decays by more than e, doubled until it is whole.
    """
    mean = np.array([name in averaged for name in model.outputs], dtype=bool)
    F, reading = _with_means(model, mean, period)
    L = np.vstack([model.L, model.D[mean]])
    doublings = _doublings(F, period)
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    step = period / 2**doublings
    total = np.zeros((len(Qc), len(F), len(F)))
    for node, weight in zip(nodes, weights, strict=True):
        driven = scipy.linalg.expm(F * (step * (1 + node) / 2)) @ L
        total += weight * step / 2 * ((driven * Qc[:, None, :]) @ driven.T)
    A = scipy.linalg.expm(F * step)
    for _ in range(doublings):
        total, A = A @ total @ A.T + total, A @ A
    n, zero = len(model.states), (np.zeros((len(F), len(F))), np.zeros((len(mean), len(F))))
    return [
        DiscreteModel(
            zero[0][:n, :n], zero[1][:, :n], Q[:n, :n], Q[:n] @ reading.T, reading @ Q @ reading.T + np.diag(single)
        )
        for Q, single in zip(total, R, strict=True)
    ]


def _with_means(model: LinearModel, mean: NDArray[np.bool_], period: float) -> tuple[Floats, Floats]:
    """Dynamics with states that integrate some outputs, and what a row reads of all states."""
    n, count = len(model.states), int(mean.sum())
    F, reading = np.zeros((n + count, n + count)), np.zeros((len(mean), n + count))
    F[:n, :n], F[n:, :n] = model.F, model.H[mean]
    reading[~mean, :n], reading[mean, n:] = model.H[~mean], np.eye(count) / period
    return F, reading


def _doublings(F: Floats, period: float) -> int:
    """How often a step in which no state decays by more than e is doubled to a period."""
    return int(np.ceil(np.log2(max(float(np.linalg.norm(F, 1)) * period, 1.0))))


def _over(F: Floats, L: Floats, period: float) -> tuple[Floats, Floats]:
    """A = exp(F h) and Q = integral of exp(F s) L L' exp(F s)' (Van Loan, IEEE Trans. Automatic Control 23(3), 1978).

    Of a step in which no state decays by more than e, doubled until it is whole: exp(-F h) overflows over long ones.
    """
    doublings = _doublings(F, period)
    n, step = len(F), period / 2**doublings
    exponential = scipy.linalg.expm(np.block([[-F, L @ L.T], [np.zeros((n, n)), F.T]]) * step)
    A = exponential[n:, n:].T
    Q = A @ exponential[:n, n:]
    for _ in range(doublings):
        A, Q = A @ A, A @ Q @ A.T + Q
    return A, (Q + Q.T) / 2
