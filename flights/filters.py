"""Filters for flight data, applied to every segment without a gap by itself.

`lowpass` and `derivative` are not causal: they are for labels and analysis, never for the input of a network in flight.
`causal_lowpass` is.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.errors import RequestError

ORDER = 4  # of the Butterworth filters, PI-TCN section IV-A
PAPER_CUTOFF = 5.0  # Hz, PI-TCN section IV-A
ANTI_ALIAS = 0.4  # cutoff over the new rate when a stream is thinned out


def lowpass(values: Floats, rate: float, cutoff: float, *, order: int = ORDER) -> Floats:
    """Zero-phase Butterworth low-pass, forward and backward.

    values: (n,) or (n, k); NaN rows split it, segments too short to filter become NaN.
    rate, cutoff: Hz.

    Raises RequestError for a cutoff that the rate does not reach.
    """
    padding = 3 * (2 * len(_sections(rate, cutoff, order)[0]) + 1)

    def both_ways(segment: Floats) -> Floats:
        return zero_phase(segment, rate, cutoff, order) if len(segment) > padding else np.full_like(segment, np.nan)

    return each_segment(values, both_ways)


def zero_phase(values: Floats, rate: float, cutoff: float, order: int = ORDER) -> Floats:
    """Zero-phase low-pass of values without gaps, of any length: scipy's sosfiltfilt with its preparations cached.

    values: (n, ...), finite. rate, cutoff: Hz. Raises RequestError for a cutoff that the rate does not reach.
    """
    sections, settled = _sections(rate, cutoff, order)
    padding = min(3 * (order + 1), len(values) - 1)
    rows = np.ascontiguousarray(np.moveaxis(values, 0, -1)).reshape(-1, len(values))
    before = 2 * rows[:, :1] - rows[:, padding:0:-1]
    after = 2 * rows[:, -1:] - rows[:, -2 : -padding - 2 : -1]
    padded = np.concatenate([before, rows, after], axis=1)
    initial = settled[:, None]
    forward, _ = scipy.signal.sosfilt(sections, padded, axis=1, zi=initial * padded[:, :1])
    backward, _ = scipy.signal.sosfilt(sections, forward[:, ::-1], axis=1, zi=initial * forward[:, -1:])
    filtered = backward[:, ::-1][:, padding : padding + len(values)]
    return np.moveaxis(filtered.reshape(*values.shape[1:], len(values)), -1, 0)


def causal_lowpass(values: Floats, rate: float, cutoff: float, *, order: int = ORDER) -> Floats:
    """Butterworth low-pass, forward only, as for a network in flight; settled at each segment's first value.

    values: (n,) or (n, k); NaN rows split it.
    rate, cutoff: Hz.

    Raises RequestError for a cutoff that the rate does not reach.
    """
    sections, settled = _sections(rate, cutoff, order)

    def forward(segment: Floats) -> Floats:
        start = settled.reshape(*settled.shape, *[1] * (segment.ndim - 1)) * segment[0]
        return np.asarray(scipy.signal.sosfilt(sections, segment, axis=0, zi=start)[0])

    return each_segment(values, forward)


def anti_aliased(values: Floats, rate: float, new_rate: float) -> Floats:
    """Values without the frequencies that a lower rate would alias; unchanged for a higher one.

    values: (n,) or (n, k).
    rate, new_rate: Hz.
    """
    if new_rate >= 0.99 * rate:
        return values
    return lowpass(values, rate, ANTI_ALIAS * new_rate)


def derivative(values: Floats, period: float) -> Floats:
    """Central differences, one-sided at the ends of each segment. values: (n,) or (n, k). period: s."""

    def differences(segment: Floats) -> Floats:
        if len(segment) < 2:
            return np.full_like(segment, np.nan)
        return np.asarray(np.gradient(segment, period, axis=0))

    return each_segment(values, differences)


def each_segment(values: Floats, function: Callable[[Floats], Floats]) -> Floats:
    """A function of consecutive rows, applied to each run of rows without NaN; rows with NaN stay NaN."""
    if not len(values):
        return values
    table = values.reshape(len(values), -1)
    finite = np.asarray(np.isfinite(table).all(axis=1))
    result = np.full_like(values, np.nan, dtype=float)
    for start, stop in runs(finite):
        result[start:stop] = function(values[start:stop])
    return result


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Start and end (exclusive) of every run of True. flags: (n,) bool."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


@cache
def _sections(rate: float, cutoff: float, order: int) -> tuple[Floats, Floats]:
    """Second-order sections and their states for a constant input of 1, (sections, 2)."""
    if not 0.0 < cutoff < 0.5 * rate:
        raise RequestError(
            f"a low-pass at {cutoff:g} Hz on data of {rate:g} Hz: wanted more than 0 and less than {0.5 * rate:g} Hz."
        )
    sections = scipy.signal.butter(order, cutoff, fs=rate, output="sos")
    return np.asarray(sections), np.asarray(scipy.signal.sosfilt_zi(sections))
