"""Movement of a column of numbers: what tells a motor's output from one that stands still."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats

MIN_SPAN = 0.01  # of the largest value, over which it moves: the noise of a still pulse is 0.4 %
MIN_VALUES = 5  # that a moving column takes: arming and a switch are fewer
MIN_CHANGES = 20  # from which fewer values count as well, as those of a coarse signal: arming and a switch change less


def moves(values: Floats) -> bool:
    """Whether a column (n,) moves: by more than a switch or the noise of its last digit. Zero is off."""
    finite = values[np.isfinite(values) & (values != 0.0)]
    if len(finite) < MIN_VALUES or not np.ptp(finite) > MIN_SPAN * np.max(np.abs(finite)):
        return False
    count = len(np.unique(finite))
    return count >= MIN_VALUES or (count > 2 and int(np.count_nonzero(np.diff(finite))) >= MIN_CHANGES)


def moving_columns(table: Floats) -> list[int]:
    """Indices of the columns of a table (n, k) that move."""
    return [index for index, column in enumerate(table.T) if moves(column)]
