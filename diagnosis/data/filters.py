"""Filters of equation-error regression: the same on both sides of the equation, after all products are formed."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from dynamics.arrays import Floats

CUTOFF = 8.0  # Hz, of the filter on both sides
SLOW = 1.5  # Hz, below which motion is no answer of the controller to turbulence
REDUCED_RATE = 25.0  # Hz after decimation
EDGE = 0.3  # s at both ends that the filters spoil


@cache
def _sections(rate: float, cutoff: float, order: int) -> tuple[Floats, Floats]:
    """Second-order sections and their states for a constant input of 1, (sections, 1, 2)."""
    sections = butter(order, cutoff / (rate / 2), output="sos")
    return np.asarray(sections), np.asarray(sosfilt_zi(sections))[:, None]


def low_pass(values: Floats, rate: float, cutoff: float = CUTOFF, order: int = 4) -> Floats:
    """Zero-phase Butterworth along the first axis: scipy's sosfiltfilt without its work at every call. (n, ...)."""
    sections, initial = _sections(rate, cutoff, order)
    pad = min(3 * _taps(sections), len(values) - 1)
    rows = np.ascontiguousarray(np.moveaxis(values, 0, -1)).reshape(-1, len(values))
    before, after = 2 * rows[:, :1] - rows[:, pad:0:-1], 2 * rows[:, -1:] - rows[:, -2 : -pad - 2 : -1]
    padded = np.concatenate([before, rows, after], axis=1)
    forward, _ = sosfilt(sections, padded, axis=1, zi=initial * padded[:, :1])
    back, _ = sosfilt(sections, forward[:, ::-1], axis=1, zi=initial * forward[:, -1:])
    found = back[:, ::-1][:, pad : pad + len(values)].reshape(*values.shape[1:], len(values))
    return np.moveaxis(found, -1, 0)


def _taps(sections: Floats) -> int:
    """The filter's order plus one."""
    return 2 * len(sections) + 1 - int(min((sections[:, 2] == 0).sum(), (sections[:, 5] == 0).sum()))


def slow(values: Floats, rate: float) -> Floats:
    """What varies below 1.5 Hz. values: (n, ...)."""
    return low_pass(values, rate, SLOW, 3)


def difference(values: Floats, rate: float) -> Floats:
    """Central difference in time, the ends repeated. values: (n, ...)."""
    result = np.empty_like(values)
    result[1:-1] = (values[2:] - values[:-2]) * (rate / 2)
    result[0], result[-1] = result[1], result[-2]
    return result


def simpson(values: Floats) -> Floats:
    """Weights (1, 4, 1)/6: what a central difference does to the integral of values, to fourth order. (n, ...)."""
    result = values.copy()
    result[1:-1] = (values[:-2] + 4 * values[1:-1] + values[2:]) / 6
    return result


def delayed(values: Floats, rate: float, delay: float) -> Floats:
    """values (n, k) as they were `delay` s ago, linear between samples; the first one before them."""
    if delay == 0.0:
        return values
    time = np.arange(len(values)) / rate
    return np.stack([np.interp(time - delay, time, column) for column in values.T], axis=1)


def kept(count: int, rate: float) -> slice:
    """The rows left after decimation to about 25 Hz without the spoilt ends."""
    edge = int(np.ceil(EDGE * rate))
    return slice(edge, count - edge, max(1, round(rate / REDUCED_RATE)))
