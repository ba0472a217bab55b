"""Speeds that the rotors really had: measured by their ESCs, else the autopilot's outputs behind the motors' lag."""

from __future__ import annotations

import math
from collections.abc import Sequence

from runtime.control.readings import Readings

ESC_PATIENCE = 0.5  # s without a speed of the ESCs, after which outputs count


class RotorSpeeds:
    """Readings of all rotors over time. Pure: times are arguments.

    measured: whether the readings are speeds of the ESCs.
    """

    def __init__(self, *, lag: float) -> None:
        """lag: s, of the motors behind the outputs."""
        self._lag = lag
        self._readings = Readings()
        self.measured = False

    def clear(self) -> None:
        """Forget all readings."""
        self._readings.clear()
        self.measured = False

    @property
    def newest(self) -> float:
        """Time of the newest reading, s; -inf without one."""
        return self._readings.newest

    def add(self, time: float, speed: Sequence[float], *, measured: bool) -> bool:
        """Add a reading. speed: (n,) rad/s, of ESCs (measured) or as the outputs command them.

        Outputs count where no ESC speaks. Returns whether the readings are now of another kind than before.
        """
        before, last = self.newest, self._readings.last
        if not measured and self.measured and time - before < ESC_PATIENCE:
            return False
        if not math.isfinite(time + sum(speed)):
            return False
        changed = last is not None and measured is not self.measured
        if changed:
            self.clear()
        self.measured = measured
        if not measured and last is not None and not changed and time > before:
            left = math.exp(-(time - before) / self._lag) if self._lag > 0 else 0.0
            speed = [now + left * (then - now) for now, then in zip(speed, last, strict=True)]
        self._readings.add(time, speed)
        return changed

    def mean(self, start: float, stop: float) -> list[float] | None:
        """Mean speeds (n,) between two times, linear between readings, rad/s; None where they do not cover them."""
        return self._readings.mean(start, stop)
