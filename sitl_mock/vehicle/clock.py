"""The vehicle's clock: it starts at boot, runs at its own speed, and a fault may set it back.

In PX4's own simulation (SITL) it is the simulation's time that runs unevenly against the companion's.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from typing import Literal

ClockKind = Literal["steady", "sitl"]
SITL_TICK = 0.004  # s, of stamps: time advances with the simulation's steps


@dataclass(slots=True)
class VehicleClock:
    """Vehicle time as a function of simulated time.

    uptime: time since boot at simulated time 0, s.
    drift: time gained per second of simulated time, s.
    jumped: sum of all jumps, s.
    tick: s in which it counts; 0 for a clock that runs on.
    """

    uptime: float = 3.0
    drift: float = 0.0
    jumped: float = 0.0
    tick: float = 0.0

    def at(self, time: float) -> float:
        """Vehicle time since boot, s, at a simulated time (s)."""
        if self.tick:
            time = math.floor(time / self.tick + 1e-6) * self.tick
        return max(0.0, self.uptime + self.jumped + time * (1.0 + self.drift))

    def nanoseconds(self, time: float) -> int:
        """Vehicle time as TIMESYNC carries it."""
        return int(self.at(time) * 1e9)

    def jump(self, seconds: float) -> None:
        """Set the clock forward (or, negative, back)."""
        self.jumped += seconds

    def restart(self, time: float) -> None:
        """Begin at 0 again at a simulated time, s."""
        self.jumped = -self.uptime - time * (1.0 + self.drift)


@dataclass(slots=True)
class UnevenTime:
    """How PX4's simulation falls behind and catches up, as measured: slow by 11 ms a second, and in steps.

    seed: of when it steps and how far.
    drift: simulated time gained per second, s.
    interval: mean time between two steps, s.
    steps: smallest and largest, s; in either direction.
    """

    seed: int = 0
    drift: float = -0.011
    interval: float = 15.0
    steps: tuple[float, float] = (0.005, 0.018)
    _random: random.Random = field(init=False)
    _next: float = field(init=False)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self._next = self._random.expovariate(1.0 / self.interval)

    def step(self, elapsed: float) -> float:
        """By how much simulated time steps forward (or, negative, back) after so many seconds; usually 0."""
        if elapsed < self._next:
            return 0.0
        self._next = elapsed + self._random.expovariate(1.0 / self.interval)
        return self._random.choice((-1.0, 1.0)) * self._random.uniform(*self.steps)
