"""Readings over time, and their means between two times."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

CAPACITY = 64
MAX_SPACING = 0.06  # s between two readings, beyond which what was in between is not known


class Readings:
    """The last readings of some quantities. Pure: times are arguments."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, Sequence[float]]] = deque(maxlen=CAPACITY)

    def clear(self) -> None:
        """Forget all readings."""
        self._rows.clear()

    @property
    def newest(self) -> float:
        """Time of the newest reading, s; -inf without one."""
        return self._rows[-1][0] if self._rows else -math.inf

    @property
    def last(self) -> Sequence[float] | None:
        """The newest reading (n,), None without one."""
        return self._rows[-1][1] if self._rows else None

    def add(self, time: float, values: Sequence[float]) -> None:
        """Add a reading (n,), unless it is not finite or none of a later time."""
        if math.isfinite(time + sum(values)) and time > self.newest:
            self._rows.append((time, values))

    def mean(self, start: float, stop: float) -> list[float] | None:
        """Mean (n,) between two times, linear between readings; None where they do not cover them."""
        if not start < stop <= self.newest:
            return None
        total: list[float] | None = None
        after, values_after = self._rows[-1]
        for time, values in reversed(self._rows):
            if time == after:
                continue
            low, high = max(time, start), min(after, stop)
            if low < high:
                if after - time > MAX_SPACING:
                    return None
                # a line's mean is its value in the middle
                share = (0.5 * (low + high) - time) / (after - time)
                part = (high - low) / (stop - start)
                means = [part * (v + share * (after_v - v)) for v, after_v in zip(values, values_after, strict=True)]
                total = means if total is None else [a + b for a, b in zip(total, means, strict=True)]
            after, values_after = time, values
            if time <= start:
                return total
        return None
