"""The low-pass at the residuals' rows, as a banded matrix: a third of the time of filtering all rows.

Its rows are the filter's own responses, which do not depend on the place further from the ends than they reach.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy
from numpy.lib.stride_tricks import as_strided

from diagnosis.data.filters import decimated_rows, simpson
from diagnosis.thresholds import FilterThresholds
from dynamics.arrays import Floats
from flights.filters import ORDER, zero_phase

NEGLECTED = 1e-11  # of a response's size
BLOCK = 16  # rows of one product
FEW = 16  # rows for each signal, from which on filtering them all is faster than making responses for them


def filtered_rows(values: Floats, rate: float, filters: FilterThresholds, *, products: bool = False) -> Floats:
    """(m, ...) low-pass of values (n, ...) at the residuals' rows. products: with Simpson's weights first.

    Of a model that has diverged the values are infinite, and the result is no number, which those who fit it look for.
    """
    count = len(values)
    rows = decimated_rows(count, rate, filters)
    signals = np.ascontiguousarray(np.moveaxis(values, 0, -1)).reshape(-1, count)
    places = np.arange(rows.start, rows.stop, rows.step)
    result = np.empty((len(signals), len(places)))
    reach = _reach(rate, filters.cutoff)
    with np.errstate(invalid="ignore", over="ignore"):
        if count <= 4 * reach and len(signals) <= count // FEW:
            weighted = simpson(signals.T) if products else signals.T
            result[:] = zero_phase(weighted, rate, filters.cutoff)[rows].T
        elif count <= 4 * reach:
            result[:] = signals @ _responses(count, rate, filters.cutoff, products)[places].T
        else:
            _apply(signals, places, reach, _responses(4 * reach, rate, filters.cutoff, products), result)
    return np.moveaxis(result.reshape(*values.shape[1:], len(places)), -1, 0)


def _apply(signals: Floats, places: np.ndarray, reach: int, responses: Floats, result: Floats) -> None:
    """Fill the results (k, m) of signals (k, n), which are longer than the responses (4 reach, 4 reach)."""
    count, size = signals.shape[1], len(responses)
    first, last = np.searchsorted(places, [reach, count - reach]).tolist()
    result[:, :first] = signals[:, : 2 * reach] @ responses[places[:first], : 2 * reach].T
    result[:, last:] = signals[:, count - 2 * reach :] @ responses[places[last:] - count, size - 2 * reach :].T
    step = int(places[1] - places[0]) if len(places) > 1 else 1
    band = _band(responses[2 * reach, reach : 3 * reach + 1], step)
    for start in range(first, last, BLOCK):
        length = min(BLOCK, last - start)
        begin, end = places[start] - reach, places[start + length - 1] + reach + 1
        result[:, start : start + length] = signals[:, begin:end] @ band[:length, : end - begin].T


def _band(response: Floats, step: int) -> Floats:
    """(BLOCK, ...) a response, each row `step` entries further."""
    matrix = np.zeros((BLOCK, (BLOCK - 1) * step + len(response)))
    along = matrix.strides[0] + step * matrix.itemsize
    as_strided(matrix, (BLOCK, len(response)), (along, matrix.itemsize))[:] = response
    return matrix


@lru_cache(maxsize=32)
def _reach(rate: float, cutoff: float) -> int:
    """Rows after which the response to an impulse is negligible, by the filter's slowest pole."""
    poles = np.abs(scipy.signal.butter(ORDER, cutoff, fs=rate, output="zpk")[1])
    return math.ceil(1.1 * math.log(NEGLECTED) / math.log(float(poles.max())))


@lru_cache(maxsize=32)
def _responses(count: int, rate: float, cutoff: float, products: bool) -> Floats:
    """(count, count) what each of `count` rows becomes, from all of them."""
    impulses = np.eye(count)
    return zero_phase(simpson(impulses) if products else impulses, rate, cutoff)
