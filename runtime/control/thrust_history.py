"""Rotor speeds whose thrust acted in the past: commands, behind the lag that the model itself does not predict."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from dynamics.arrays import Floats

HISTORY = 64  # commands that are remembered


class ThrustHistory:
    """Commands behind a first-order lag, each in the mean of its period. Pure: times are arguments.

    count: commands so far.
    """

    def __init__(self, hover: Floats, *, lag: float, period: float) -> None:
        """hover: (n,) rad/s. lag: s. period: between commands, s."""
        self._hover, self._lag, self._period = hover, lag, period
        self._times = [-math.inf] * HISTORY
        self._speeds = np.tile(hover, (HISTORY, 1))
        self._response = hover.copy()
        self.count = 0

    def clear(self) -> None:
        """Forget all commands; thrust is that of hover."""
        self._times[:], self.count = [-math.inf] * HISTORY, 0
        self._response[:] = self._hover

    def add(self, time: float, speed: Floats) -> None:
        """Let thrust follow a command, rotor speeds (n,) rad/s that act from a time on, for a period."""
        left = math.exp(-self._period / self._lag) if self._lag > 0 else 0.0
        away = self._response - speed
        slot = self.count % HISTORY
        self._times[slot], self._speeds[slot] = time, speed + (1 - left) * self._lag / self._period * away
        self._response = speed + left * away
        self.count += 1

    def acted(self, start: float, stop: float) -> tuple[Floats, Floats]:
        """Rotor speeds (k, n) whose thrust acted between two times, and for how many seconds (k,) each did."""
        times, oldest, last = self._times, max(0, self.count - HISTORY), self.count - 1
        while last > oldest and times[last % HISTORY] >= stop:
            last -= 1
        first = last
        while first > oldest and times[first % HISTORY] > start:
            first -= 1
        slots = [tick % HISTORY for tick in range(first, last + 1)]
        edges = [start, *(times[slot] for slot in slots[1:]), stop]
        return self._speeds[slots], np.array([after - before for before, after in pairwise(edges)])
