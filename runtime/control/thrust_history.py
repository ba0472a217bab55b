"""Rotor speeds whose thrust acted in the past: commands, behind the lag that the model itself does not predict."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dynamics.arrays import Floats

HISTORY = 64  # commands that are remembered


class ThrustHistory:
    """Commands behind a first-order lag, each in the mean of its period. Pure: times are arguments.

    count: commands so far.
    """

    def __init__(self, hover: Floats, *, lag: float, period: float) -> None:
        """hover: (n,) rad/s. lag: s. period: between commands, s."""
        self._hover = hover.tolist()
        self._left = math.exp(-period / lag) if lag > 0 else 0.0  # of the response after a period
        self._mean = (1 - self._left) * lag / period  # of it in that period
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
        left, mean, slot = self._left, self._mean, self.count % HISTORY
        pairs = list(zip(speed, self._response, strict=True))
        self._times[slot] = time
        self._speeds[slot] = [now + mean * (then - now) for now, then in pairs]
        self._response = [now + left * (then - now) for now, then in pairs]
        self.count += 1

    def acted(self, start: float, stop: float) -> tuple[list[list[float]], list[float]]:
        """Rotor speeds (k, n) whose thrust acted between two times, and for how many seconds (k,) each did."""
        times, oldest, last = self._times, max(0, self.count - HISTORY), self.count - 1
        while last > oldest and times[last % HISTORY] >= stop:
            last -= 1
        first = last
        while first > oldest and times[first % HISTORY] > start:
            first -= 1
        speeds, seconds, before = [], [], start
        for tick in range(first, last + 1):
            after = times[(tick + 1) % HISTORY] if tick < last else stop
            speeds.append(self._speeds[tick % HISTORY])
            seconds.append(after - before)
            before = after
        return speeds, seconds
