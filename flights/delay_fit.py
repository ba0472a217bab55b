"""The delay, or lag, of one set of signals behind another, with its standard deviation: the estimator.

y(t) = x(t - d) B + z(t) C + noise with B and C free; d by variable projection and Gauss-Newton. Its variance comes from
the scores of blocks of flight (sandwich estimate), because the noise is coloured. For a lag, x passes 1 / (d s + 1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, signal, stats

from flights import filters
from flights.log import Floats

Band = tuple[float, float]

NARROWEST = 2.0  # highest over lowest frequency
OVERSAMPLING = 4.0  # rows compared per period of the highest frequency
EARLIEST, LATEST, STEP = -0.12, 0.2, 0.01  # s searched for delays,
LAGS = (0.002, 0.25)  # s, and for lags
EDGE = 0.5  # s at the ends of each stretch that the filters spoil
BLOCK = 2.0  # s over which scores are summed
LEAST_BLOCKS = 4
CALIBRATION = 1.0  # on the standard deviation
CONFIDENCE = 0.95
ITERATIONS = 8


@dataclass(frozen=True)
class FittedDelay:
    """seconds, std, and half of the 95 % interval, s. compared: s of flight it rests on."""

    seconds: float
    std: float
    reach: float
    compared: float


def fit_delay(
    answer: Floats, drive: Floats, beside: Floats, rate: float, band: Band, usable: NDArray[np.bool_], *, lags: bool
) -> FittedDelay | None:
    """How far `answer` (n, m) is behind `drive` (n, p); beside: (n, q) what else it follows, undelayed.

    All on one grid of a rate, Hz; NaN where not known. band: Hz compared. usable: (n,) rows. lags: fit a first-order
    lag instead. None when there is too little flight, or no best delay within reach.
    """
    if band[1] < NARROWEST * band[0]:
        return None  # logged too slowly to be compared at all
    known = usable & np.isfinite(np.hstack([answer, drive, beside])).all(axis=1)
    stretches = [
        _Stretch.of([part[start:stop] for part in (answer, drive, beside)], rate, band, lags=lags)
        for start, stop in filters.runs(known)
        if (stop - start) / rate >= 2 * EDGE + BLOCK
    ]
    count = sum(len(stretch.blocks) for stretch in stretches)
    if count < LEAST_BLOCKS:
        return None
    first, last = LAGS if lags else (EARLIEST, LATEST)
    trials = np.arange(first, last + STEP / 2, STEP)
    best = int(np.argmin([_misfit(stretches, float(trial)) for trial in trials]))
    if best == len(trials) - 1 or (best == 0 and not lags):
        return None
    delay, std = float(trials[best]), float("inf")
    for _ in range(ITERATIONS):
        change, std = _gauss_newton(stretches, delay)
        delay = float(np.clip(delay + np.clip(change, -STEP, STEP), first, last))
        if abs(change) < 1e-6:
            break
    std *= CALIBRATION
    reach = float(stats.t.ppf(0.5 + CONFIDENCE / 2, count - 1)) * std
    return FittedDelay(delay, std, reach, round(count * BLOCK, 1))


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A stretch of flight without a gap. answer: (n, m), beside: (n, q), of the rows compared.

    blocks: first row of each block. driven: rows of what drives it (n, p), delayed or lagged by so many seconds.
    """

    answer: Floats
    beside: Floats
    blocks: NDArray[np.intp]
    driven: Callable[[float], Floats]

    @classmethod
    def of(cls, sides: list[Floats], rate: float, band: tuple[float, float], *, lags: bool) -> _Stretch:
        """sides: answer, drive and beside, (n, .) each on a grid of a rate, Hz."""
        answer, drive, beside = (_band(part, rate, band) for part in sides)
        every = max(1, int(rate / (OVERSAMPLING * band[1])))
        length = round(BLOCK * rate / every)
        count = int((len(answer) / rate - 2 * EDGE) / (length * every / rate))
        rows = round(EDGE * rate) + every * np.arange(count * length)
        driven = _lagged(drive, rate, rows) if lags else _delayed(drive, rate, rows)
        return cls(answer[rows], beside[rows], np.arange(count) * length, driven)


def _delayed(drive: Floats, rate: float, rows: NDArray[np.intp]) -> Callable[[float], Floats]:
    spline = interpolate.CubicSpline(np.arange(len(drive)) / rate, drive)
    return lambda seconds: np.asarray(spline(rows / rate - seconds))


def _lagged(drive: Floats, rate: float, rows: NDArray[np.intp]) -> Callable[[float], Floats]:
    def driven(seconds: float) -> Floats:
        # exact for a drive that is linear between its rows (first-order hold)
        step = 1 / rate / seconds
        keep = np.exp(-step)
        now, before = 1 - (1 - keep) / step, (1 - keep) / step - keep
        return np.asarray(signal.lfilter([now, before], [1, -keep], drive, axis=0)[rows])

    return driven


def _band(values: Floats, rate: float, band: tuple[float, float]) -> Floats:
    if not values.shape[1]:
        return values
    smooth = filters.lowpass(values, rate, band[1])
    return smooth - filters.lowpass(smooth, rate, band[0], order=1)


def _columns(stretches: list[_Stretch], delay: float) -> Floats:
    return np.concatenate([np.hstack([stretch.driven(delay), stretch.beside]) for stretch in stretches])


def _fit(stretches: list[_Stretch], delay: float) -> tuple[Floats, Floats, Floats]:
    """Residuals, columns and coefficients at a delay."""
    answer = np.concatenate([stretch.answer for stretch in stretches])
    columns = _columns(stretches, delay)
    coefficients = _solve(columns, answer)
    return answer - columns @ coefficients, columns, coefficients


def _solve(columns: Floats, answer: Floats) -> Floats:
    """Least squares by the normal equations of scaled columns: few columns, many rows, thirty trials."""
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns)) + 1e-12
    scaled = columns / scale
    gram = scaled.T @ scaled + 1e-10 * np.eye(len(scale))
    return np.asarray(np.linalg.solve(gram, scaled.T @ answer) / scale[:, None])


def _misfit(stretches: list[_Stretch], delay: float) -> float:
    """Sum of the log residual variances at a delay."""
    residual, _, _ = _fit(stretches, delay)
    return float(np.sum(np.log(np.mean(residual**2, axis=0) + 1e-300)))


def _gauss_newton(stretches: list[_Stretch], delay: float) -> tuple[float, float]:
    """The next change of the delay and the standard deviation that the blocks' scores give it, s."""
    residual, columns, coefficients = _fit(stretches, delay)
    small = 1e-4
    slope = (_columns(stretches, delay + small) - _columns(stretches, delay - small)) / (2 * small)
    direction = slope @ coefficients
    direction -= columns @ _solve(columns, direction)  # what free coefficients cannot explain
    weight = 1 / np.mean(residual**2, axis=0)
    information = float(np.sum(weight * direction**2))
    if information <= 0.0:
        return 0.0, float("inf")
    scores = np.sum(weight * direction * residual, axis=1)
    lengths = np.cumsum([0, *(len(stretch.answer) for stretch in stretches)])
    starts = np.concatenate([stretch.blocks + start for stretch, start in zip(stretches, lengths, strict=False)])
    sums = np.add.reduceat(scores, starts)
    spread = float(np.sum((sums - sums.mean()) ** 2)) * len(sums) / (len(sums) - 1)
    return float(sums.sum()) / information, float(np.sqrt(spread)) / information
