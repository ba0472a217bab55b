"""The vehicle's clock: it starts at boot, runs at its own speed, and a fault may set it back."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class VehicleClock:
    """Vehicle time as a function of simulated time.

    uptime: time since boot at simulated time 0, s.
    drift: time gained per second of simulated time, s.
    jumped: sum of all jumps, s.
    """

    uptime: float = 3.0
    drift: float = 0.0
    jumped: float = 0.0

    def at(self, time: float) -> float:
        """Vehicle time since boot, s, at a simulated time (s)."""
        return max(0.0, self.uptime + self.jumped + time * (1.0 + self.drift))

    def nanoseconds(self, time: float) -> int:
        """Vehicle time as TIMESYNC carries it."""
        return int(self.at(time) * 1e9)

    def jump(self, seconds: float) -> None:
        """Set the clock forward (or, negative, back)."""
        self.jumped += seconds
