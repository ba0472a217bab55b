"""Filters for flight data, applied to every segment without a gap by itself.

`lowpass` and `derivative` are not causal: they are for labels and analysis, never for the input of a network in flight.
`causal_lowpass` is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import signal

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
    sections = _sections(rate, cutoff, order)
    padding = 3 * (2 * len(sections) + 1)

    def both_ways(segment: Floats) -> Floats:
        if len(segment) <= padding:
            return np.full_like(segment, np.nan)
        return np.asarray(signal.sosfiltfilt(sections, segment, axis=0))

    return each_segment(values, both_ways)


def causal_lowpass(values: Floats, rate: float, cutoff: float, *, order: int = ORDER) -> Floats:
    """The same Butterworth low-pass, forward only, as for a network in flight; settled at each segment's first value.

    values: (n,) or (n, k); NaN rows split it.
    rate, cutoff: Hz.

    Raises RequestError for a cutoff that the rate does not reach.
    """
    sections = _sections(rate, cutoff, order)
    settled = signal.sosfilt_zi(sections)

    def forward(segment: Floats) -> Floats:
        start = settled.reshape(*settled.shape, *[1] * (segment.ndim - 1)) * segment[0]
        return np.asarray(signal.sosfilt(sections, segment, axis=0, zi=start)[0])

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


def _sections(rate: float, cutoff: float, order: int) -> Floats:
    if not 0.0 < cutoff < 0.5 * rate:
        raise RequestError(
            f"a low-pass at {cutoff:g} Hz on data of {rate:g} Hz: wanted more than 0 and less than {0.5 * rate:g} Hz."
        )
    return np.asarray(signal.butter(order, cutoff, fs=rate, output="sos"))
