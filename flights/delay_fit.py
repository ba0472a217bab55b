"""The delay, or lag, of one set of signals behind another, with its standard deviation: the estimator.

y(t) = x(t - d) B + z(t) C + noise with B and C free; d by variable projection and Gauss-Newton. Its variance comes from
the scores of blocks of flight (sandwich estimate), because the noise is coloured. For a lag, x = g(u) of a signal u
that has passed 1 / (d s + 1): a motor's speed follows its command, and thrust is a curve of the speed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from dynamics.arrays import Floats
from flights import filters

Band = tuple[float, float]
ThrustCurve = Callable[[Floats], Floats]

MIN_BAND_RATIO = 2.0  # highest over lowest frequency
OVERSAMPLING = 2.2  # rows compared per period of the highest frequency, so that they fill their band
AUTOREGRESSION = 6  # of the noise
MIN_DELAY, MAX_DELAY, STEP = -0.12, 0.2, 0.01  # s, grid of the search for delays
LAGS = (0.002, 0.25)  # s, limits of the search for lags
EDGE = 0.5  # s at both ends of a segment that the filters' transients disturb
BLOCK = 2.0  # s over which scores are summed
MIN_BLOCKS = 4
CALIBRATION = 1.1  # factor on the standard deviation, by benchmarks readers delays
CONFIDENCE = 0.95
STAMPS = 0.00015  # s, uncertainty of the time to which a sample belongs
ITERATIONS = 8
DIFFERENCE = 1e-4  # s, for derivatives with respect to the delay


@dataclass(frozen=True)
class FittedDelay:
    """A delay with its uncertainty.

    seconds, std: the estimate and its standard deviation.
    reach: half of the 95 % interval, s.
    compared: s of flight.
    explained: share of the answer's variance, 0 to 1.
    """

    seconds: float
    std: float
    reach: float
    compared: float
    explained: float


def fit_delay(
    answer: Floats,
    drive: Floats,
    undelayed: Floats,
    rate: float,
    band: Band,
    usable: NDArray[np.bool_],
    *,
    paired: bool = False,
    lagged: ThrustCurve | None = None,
    whiten: bool = True,
    closed_loop: float = 0.0,
) -> FittedDelay | None:
    """The delay of `answer` behind `drive`; None with too little flight, or with no optimum inside the search limits.

    answer, drive, undelayed: (n, m), (n, p), (n, q) on one grid; NaN where missing. undelayed: further regressors.
    rate: of the grid, Hz.
    band: frequencies that are compared, Hz.
    usable: (n,) rows.
    paired: each answer follows its own drive only, with m = p: on a circle, a rotation of the axes and a delay look
        the same.
    lagged: fit a first-order lag of the drive instead; the answer follows this curve of it.
    whiten: weight frequencies by the noise there; without it the fit is best where most of the motion is.
    closed_loop: s within which a controller answers an unexplained part, which then looks like a delay; its share goes
        into the interval.
    """
    if band[1] < MIN_BAND_RATIO * band[0]:
        return None  # logged too slowly for a comparison
    comparable = usable & np.isfinite(np.hstack([answer, drive, undelayed])).all(axis=1)
    every = [
        _Segment.of([part[start:stop] for part in (answer, drive, undelayed)], rate, band, paired=paired, lagged=lagged)
        for start, stop in filters.runs(comparable)
        if (stop - start) / rate >= 2 * EDGE + BLOCK
    ]
    segments = [segment for segment in every if len(segment.blocks)]  # rows that are thinned may fall short of one
    count = sum(len(segment.blocks) for segment in segments)
    if count < MIN_BLOCKS:
        return None
    first, last = (MIN_DELAY, MAX_DELAY) if lagged is None else LAGS
    trials = np.arange(first, last + STEP / 2, STEP)
    best = int(np.argmin([_log_variance(segments, float(trial)) for trial in trials]))
    if best == len(trials) - 1 or (best == 0 and lagged is None):
        return None
    delay, std, unexplained = float(trials[best]), float("inf"), 1.0
    for _ in range(ITERATIONS):
        change, std, unexplained = _gauss_newton(segments, delay, whiten=whiten)
        delay = float(np.clip(delay + np.clip(change, -STEP, STEP), first, last))
        if abs(change) < 1e-6:
            break
    random, systematic = CALIBRATION * std, float(np.hypot(closed_loop * unexplained, STAMPS))
    tail = 0.5 + CONFIDENCE / 2
    reach = float(np.hypot(scipy.stats.t.ppf(tail, count - 1) * random, scipy.stats.norm.ppf(tail) * systematic))
    return FittedDelay(delay, float(np.hypot(random, systematic)), reach, round(count * BLOCK, 1), 1 - unexplained)


@dataclass(frozen=True, eq=False)
class _Segment:
    """A segment of flight without a gap, of the rows that are compared.

    answer: (n, m).
    undelayed: (n, q).
    blocks: first row of each block.
    driven: rows of the drive (n, p), delayed or lagged by a number of seconds.
    paired: whether each answer follows its own drive only.
    """

    answer: Floats
    undelayed: Floats
    blocks: NDArray[np.intp]
    driven: Callable[[float], Floats]
    paired: bool

    @classmethod
    def of(cls, sides: list[Floats], rate: float, band: Band, *, paired: bool, lagged: ThrustCurve | None) -> _Segment:
        """sides: answer, drive and undelayed regressors, (n, .) each on a grid of a rate, Hz."""
        drive = sides[1]
        answer, undelayed = (_band(part, rate, band) for part in (sides[0], sides[2]))
        every = max(1, int(rate / (OVERSAMPLING * band[1])))
        length = round(BLOCK * rate / every)
        count = int((len(answer) / rate - 2 * EDGE) / (length * every / rate))
        rows = round(EDGE * rate) + every * np.arange(count * length)
        if lagged is None:
            driven = _delayed(_band(drive, rate, band), rate, rows)
        else:
            driven = _lagged(drive, rate, band, lagged, rows)
        return cls(answer[rows], undelayed[rows], np.arange(count) * length, driven, paired)


def _delayed(drive: Floats, rate: float, rows: NDArray[np.intp]) -> Callable[[float], Floats]:
    spline = scipy.interpolate.CubicSpline(np.arange(len(drive)) / rate, drive)
    return lambda seconds: np.asarray(spline(rows / rate - seconds))


def _lagged(
    drive: Floats, rate: float, band: Band, curve: ThrustCurve, rows: NDArray[np.intp]
) -> Callable[[float], Floats]:
    since_start = drive - drive[0]  # so that the lag begins settled

    def driven(seconds: float) -> Floats:
        # exact for a drive that is linear between its rows (first-order hold)
        step = 1 / rate / seconds
        keep = np.exp(-step)
        now, before = 1 - (1 - keep) / step, (1 - keep) / step - keep
        followed = drive[0] + scipy.signal.lfilter([now, before], [1, -keep], since_start, axis=0)
        return _band(curve(followed), rate, band)[rows]

    return driven


def _band(values: Floats, rate: float, band: tuple[float, float]) -> Floats:
    if not values.shape[1]:
        return values
    smooth = filters.lowpass(values, rate, band[1])
    return smooth - filters.lowpass(smooth, rate, band[0], order=1)


@dataclass(frozen=True, eq=False)
class _Side:
    """One answer (n,), its regressors (n, p + q), and their derivatives (n, p) with respect to the delay."""

    answer: Floats
    columns: Floats
    slope: Floats

    @property
    def residual(self) -> Floats:
        """The least-squares residual, (n,)."""
        return self.answer - self.columns @ _solve(self.columns, self.answer)

    def whitened(self, ends: NDArray[np.intp]) -> _Side:
        """Side after a filter that makes the residual white."""
        whitening = _prediction_error(self.residual)

        def white(values: Floats) -> Floats:
            return np.concatenate(
                [scipy.signal.lfilter(whitening, [1.0], part, axis=0) for part in np.split(values, ends)]
            )

        return _Side(white(self.answer), white(self.columns), white(self.slope))


def _sides(segments: list[_Segment], delay: float, *, sloped: bool = True) -> list[_Side]:
    """Every answer over all segments, with its regressors at a delay. sloped: else all slopes are 0."""
    answer = np.concatenate([segment.answer for segment in segments])
    undelayed = np.concatenate([segment.undelayed for segment in segments])

    def driven(seconds: float) -> Floats:
        return np.concatenate([segment.driven(seconds) for segment in segments])

    now = driven(delay)
    apart = 2 * DIFFERENCE
    slope = (driven(delay + DIFFERENCE) - driven(delay - DIFFERENCE)) / apart if sloped else np.zeros_like(now)
    choose = [[k] if segments[0].paired else slice(None) for k in range(answer.shape[1])]
    return [_Side(answer[:, k], np.hstack([now[:, c], undelayed]), slope[:, c]) for k, c in enumerate(choose)]


def _log_variance(segments: list[_Segment], delay: float) -> float:
    """Sum of the log residual variances at a delay."""
    return float(sum(np.log(np.mean(side.residual**2) + 1e-300) for side in _sides(segments, delay, sloped=False)))


def _gauss_newton(segments: list[_Segment], delay: float, *, whiten: bool) -> tuple[float, float, float]:
    """The next change of the delay, its standard deviation by the blocks' scores, s, and the unexplained share."""
    score, information, unexplained = 0.0, 0.0, 0.0
    starts = np.concatenate([[0], np.cumsum([len(segment.answer) for segment in segments])])
    edges = np.concatenate([segment.blocks + start for segment, start in zip(segments, starts, strict=False)])
    sums = np.zeros(len(edges))
    for raw in _sides(segments, delay):
        if float(np.mean(raw.residual**2)) < 1e-20:
            continue  # a channel that stands still has no information
        side = raw.whitened(starts[1:-1]) if whiten else raw
        coefficients, residual = _solve(side.columns, side.answer), side.residual
        direction = side.slope @ coefficients[: side.slope.shape[1]]
        direction = direction - side.columns @ _solve(side.columns, direction)  # orthogonal to the regressors
        weight = 1 / float(np.mean(residual**2))
        share_of_information = weight * float(np.sum(direction**2))
        information += share_of_information
        unexplained += share_of_information * float(np.mean(raw.residual**2) / np.mean(raw.answer**2))
        parts = weight * direction * residual
        score += float(parts.sum())
        sums += np.add.reduceat(parts, edges)
    if information <= 0.0:
        return 0.0, float("inf"), 1.0
    spread = float(np.sum((sums - sums.mean()) ** 2)) * len(sums) / (len(sums) - 1)
    std = max(float(np.sqrt(spread)) / information, information**-0.5)
    return score / information, std, unexplained / information


def _solve(columns: Floats, answer: Floats) -> Floats:
    """Least squares (p,) by the normal equations of scaled columns: few columns, many rows, thirty trials."""
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns)) + 1e-12
    scaled = columns / scale
    gram = scaled.T @ scaled + 1e-10 * np.eye(len(scale))
    return np.asarray(np.linalg.solve(gram, scaled.T @ answer) / scale)


def _prediction_error(residual: Floats) -> Floats:
    """The filter 1 - a1 z^-1 ... that makes an autoregressive noise white (Yule-Walker)."""
    order = min(AUTOREGRESSION, len(residual) // 20)
    lags = np.array([float(residual[: len(residual) - k] @ residual[k:]) for k in range(order + 1)])
    if order == 0 or lags[0] <= 0.0:
        return np.ones(1)
    lags[0] *= 1.0 + 1e-4
    return np.concatenate([[1.0], -scipy.linalg.solve_toeplitz(lags[:order], lags[1:])])
