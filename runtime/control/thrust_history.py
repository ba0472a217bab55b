"""Rotor speeds whose thrust acted in the past: commands, behind the lag that the model itself does not predict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from dynamics.arrays import Floats

HISTORY = 64  # commands that are remembered


class ThrustHistory:
    """Commands behind a first-order lag, each in the mean of its period. Pure: times are arguments.

    count: commands so far.
    """

    def __init__(self, hover: Floats, *, lag: float, period: float) -> None:
        """hover: (n,) rad/s. lag: s. period: between commands, s."""
        self._hover, self._lag, self._period = hover.tolist(), lag, period
        self._times = [-math.inf] * HISTORY
        self._speeds: list[list[float]] = [self._hover] * HISTORY
        self._response: list[float] = self._hover
        self.count = 0

    def clear(self) -> None:
        """Forget all commands; thrust is that of hover."""
        self._times[:], self.count = [-math.inf] * HISTORY, 0
        self._response = self._hover

    def add(self, time: float, speed: Sequence[float]) -> None:
        """Let thrust follow a command, rotor speeds (n,) rad/s that act from a time on, for a period."""
        left = math.exp(-self._period / self._lag) if self._lag > 0 else 0.0
        mean = (1 - left) * self._lag / self._period
        away = [then - now for then, now in zip(self._response, speed, strict=True)]
        slot = self.count % HISTORY
        self._times[slot] = time
        self._speeds[slot] = [now + mean * each for now, each in zip(speed, away, strict=True)]
        self._response = [now + left * each for now, each in zip(speed, away, strict=True)]
        self.count += 1

    def acted(self, start: float, stop: float) -> tuple[list[list[float]], list[float]]:
        """Rotor speeds (k, n) whose thrust acted between two times, and for how many seconds (k,) each did."""
        times, oldest, last = self._times, max(0, self.count - HISTORY), self.count - 1
        while last > oldest and times[last % HISTORY] >= stop:
            last -= 1
        first = last
        while first > oldest and times[first % HISTORY] > start:
            first -= 1
        slots = [tick % HISTORY for tick in range(first, last + 1)]
        edges = [start, *(times[slot] for slot in slots[1:]), stop]
        return [self._speeds[slot] for slot in slots], [after - before for before, after in pairwise(edges)]
