"""Movement of a column of numbers: what tells a motor's output from one that stands still."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats

MIN_VALUES = 5  # that a moving column takes: arming, a switch and a stick's last digit are fewer
MIN_SPAN = 0.01  # of the largest value, over which it moves: the noise of a still pulse is 0.4 %


def moves(values: Floats) -> bool:
    """Whether a column (n,) moves: by more than a switch or the noise of its last digit."""
    finite = values[np.isfinite(values)]
    if len(finite) < MIN_VALUES or not np.ptp(finite) > MIN_SPAN * np.max(np.abs(finite)):
        return False
    return len(np.unique(finite)) >= MIN_VALUES


def moving_columns(table: Floats) -> list[int]:
    """Indices of the columns of a table (n, k) that move."""
    return [index for index, column in enumerate(table.T) if moves(column)]
