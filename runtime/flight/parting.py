"""The end of a stream of setpoints: PX4 holds the last one until its failsafe acts, so it must be one to be held. Pure.

A vehicle in the air is levelled for a moment and then sent still setpoints at hover thrust, several of them, as some
may be lost. On the ground the still ones have no thrust.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats
from runtime.flight.failsafe import LevelHold

LEVELLING = 0.3  # s, at most, in which a vehicle in the air is levelled before its last setpoints
LEVEL_RATE = 0.1  # rad/s of levelling, below which it is level enough
STILL_SETPOINTS = 5  # without a rate, at the end: with 30 % of frames lost, one in 400 streams loses all of them


class Parting:
    """The last setpoints of a stream.

    active: whether any is still to be sent.
    """

    def __init__(self, hold: LevelHold, period: float) -> None:
        """hold: which brings the vehicle upright. period: between setpoints, s."""
        self.active = False
        self._hold, self._period = hold, period
        self._thrust = 0.0
        self._level_until = 0.0
        self._left = 0

    def begin(self, time: float, collective_thrust: float, *, levels: bool) -> None:
        """End the stream. collective_thrust: of the last setpoints, N. levels: whether to level the vehicle first."""
        self.active, self._left = True, STILL_SETPOINTS
        self._thrust = collective_thrust
        self._level_until = time + LEVELLING if levels else time

    def cancel(self) -> None:
        """Send none of them: a new stream has begun, or the vehicle has disarmed."""
        self.active = False

    def command(self, time: float) -> tuple[Floats, float]:
        """Rates (3,) rad/s and collective thrust, N, to send now."""
        if time < self._level_until:
            rate, _ = self._hold.command(self._period)
            if float(np.linalg.norm(rate)) > LEVEL_RATE:
                return rate, self._thrust
            self._level_until = time
        self._left -= 1
        self.active = self._left > 0
        return np.zeros(3), self._thrust
