"""Filters of residuals: the same on both sides of the equation of motion, after all products are formed."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded

from diagnosis.thresholds import FilterThresholds
from dynamics.arrays import Floats
from flights.filters import zero_phase


def slow(values: Floats, rate: float, cutoff: float) -> Floats:
    """Low-pass of third order. values: (n, ...) at rate Hz."""
    return zero_phase(values, rate, cutoff, 3)


def difference(values: Floats, rate: float) -> Floats:
    """Central difference in time, the ends repeated. values: (n, ...)."""
    result = np.empty_like(values)
    result[1:-1] = (values[2:] - values[:-2]) * (rate / 2)
    result[0], result[-1] = result[1], result[-2]
    return result


def simpson(values: Floats) -> Floats:
    """Values (n, ...) weighted (1, 4, 1)/6, which matches `difference` of their integral to fourth order."""
    result = values.copy()
    result[1:-1] = (values[:-2] + 4 * values[1:-1] + values[2:]) / 6
    return result


def simpson_inverse(values: Floats) -> Floats:
    """Values (n, k) whose Simpson average is `values`, the ends as they are."""
    bands = np.zeros((3, len(values)))
    bands[1, [0, -1]] = 1.0
    bands[1, 1:-1], bands[0, 2:], bands[2, :-2] = 4 / 6, 1 / 6, 1 / 6
    return np.asarray(solve_banded((1, 1), bands, values))


def rate_of_change(values: Floats, rate: float) -> Floats:
    """Derivative in time of what enters products: its Simpson average is the central difference. values: (n, k).

    The compact scheme of fourth order (Lele, J. Comput. Phys. 103, 1992, eq. 2.1.6). A central difference that is
    averaged besides is 1 % too small at 4 Hz in a log of 100 Hz and 4 % at 8 Hz, and what it multiplies comes out as
    much too large.
    """
    return simpson_inverse(difference(values, rate))


def mean_of_held(values: Floats, share: float) -> Floats:
    """Values whose Simpson average is the mean of the two periods about a row, which `difference` of an integral has.

    share: of a period's later row in its mean; 0 for values (n, k) that hold from their row on, 1 up to their row.
    """
    means = values.copy()
    means[1:-1] = ((1 - share) * values[:-2] + values[1:-1] + share * values[2:]) / 2
    return simpson_inverse(means)


def delayed(values: Floats, rate: float, delay: float) -> Floats:
    """values (n, k) as they were `delay` s ago, linear between samples; the first one before them."""
    if delay == 0.0:
        return values
    rows, share = divmod(-delay * rate, 1.0)
    place = np.arange(len(values)) + int(rows)
    last = len(values) - 1
    return (1 - share) * values[np.clip(place, 0, last)] + share * values[np.clip(place + 1, 0, last)]


def advanced(values: Floats, rate: float, by: float) -> Floats:
    """values (n, k) as they are `by` s later: the cubic through the four nearest rows, the ends held.

    A straight line between two rows would lose 3 % at 8 Hz in a log of 100 Hz (Laakso et al., Splitting the unit delay,
    IEEE Signal Processing Magazine 13, 1996).
    """
    rows, share = divmod(by * rate, 1.0)
    weights = (
        -share * (share - 1) * (share - 2) / 6,
        (share + 1) * (share - 1) * (share - 2) / 2,
        -(share + 1) * share * (share - 2) / 2,
        (share + 1) * share * (share - 1) / 6,
    )
    place = np.arange(len(values)) + int(rows)
    near = (np.clip(place + offset, 0, len(values) - 1) for offset in (-1, 0, 1, 2))
    return np.asarray(sum(weight * values[at] for weight, at in zip(weights, near, strict=True)))


def decimation(rate: float, filters: FilterThresholds) -> int:
    """Number of rows at rate Hz for each row of the residuals."""
    return max(1, round(rate / filters.rate))


def decimated_rows(count: int, rate: float, filters: FilterThresholds) -> slice:
    """The rows of the residuals among `count` at rate Hz, without the ends that the filters spoil."""
    edge = int(np.ceil(filters.edge * rate))
    return slice(edge, count - edge, decimation(rate, filters))
