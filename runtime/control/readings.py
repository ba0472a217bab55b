"""Readings over time, and their means between two times."""

from __future__ import annotations

import math

import numpy as np

from dynamics.arrays import Floats

CAPACITY = 64
MAX_SPACING = 0.06  # s between two readings, beyond which what was in between is not known


class Readings:
    """The last readings of some quantities. Pure: times are arguments."""

    def __init__(self, count: int) -> None:
        """count: quantities."""
        self._times = np.zeros(CAPACITY)
        self._values = np.zeros((CAPACITY, count))
        self._count = 0

    def clear(self) -> None:
        """Forget all readings."""
        self._count = 0

    @property
    def newest(self) -> float:
        """Time of the newest reading, s; -inf without one."""
        return float(self._times[(self._count - 1) % CAPACITY]) if self._count else -math.inf

    @property
    def last(self) -> Floats | None:
        """The newest reading (n,), None without one."""
        return self._values[(self._count - 1) % CAPACITY] if self._count else None

    def add(self, time: float, values: Floats) -> None:
        """Add a reading (n,), unless it is not finite or none of a later time."""
        if not math.isfinite(time + float(values.sum())) or time <= self.newest:
            return
        slot = self._count % CAPACITY
        self._times[slot], self._values[slot] = time, values
        self._count += 1

    def mean(self, start: float, stop: float) -> Floats | None:
        """Mean (n,) between two times, linear between readings; None where they do not cover them."""
        slots = np.arange(max(0, self._count - CAPACITY), self._count) % CAPACITY
        times = self._times[slots]
        first, last = int(np.searchsorted(times, start, "right")) - 1, int(np.searchsorted(times, stop, "left"))
        if first < 0 or last >= len(times) or np.diff(times[first : last + 1]).max() > MAX_SPACING:
            return None
        near, values = times[first : last + 1], self._values[slots[first : last + 1]]
        grid = np.concatenate([[start], near[1:-1], [stop]])
        after = np.clip(np.searchsorted(near, grid, "left"), 1, len(near) - 1)
        share = (grid - near[after - 1]) / (near[after] - near[after - 1])
        at = values[after - 1] + share[:, None] * (values[after] - values[after - 1])
        return np.asarray(np.diff(grid) @ (0.5 * (at[1:] + at[:-1])) / (stop - start))
