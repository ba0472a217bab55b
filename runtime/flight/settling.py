"""How thrust goes away after a contact: level, until the ground is known to carry the vehicle, then at once. Pure."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, RATE, VELOCITY
from runtime.flight.contact import ForceMeter, tilt_of
from runtime.flight.failsafe import level_rate
from runtime.flight.ground_probe import Ground, GroundProbe
from runtime.running_mean import RunningMean

LEVEL_GAIN, LEVEL_LIMIT = 6.0, 2.0  # 1/s and rad/s, of levelling after a contact
STILL, STILL_TIME = 0.25, 0.04  # rad/s of tilting, averaged over s, at which thrust may end
MAX_BRAKING = 0.25  # s for which it is kept to stop that
SHUTDOWN_TIME = 0.3  # s in which thrust is ramped to zero on the ground, unless the ground carries already
ZERO_RATE = np.zeros(3)


class Settling:
    """A contact from its first sign to the end of thrust.

    cause: of a contact in flight; empty in a landing.
    """

    def __init__(self, weight: float, rate_limit: float) -> None:
        """weight: N. rate_limit: rad/s, of tilting."""
        self.cause = ""
        self._weight, self._rate_limit = weight, rate_limit
        self._probe: GroundProbe | None = None
        self._carried_since: float | None = None
        self._tilting = RunningMean(STILL_TIME, 0.0)
        self._last = 0.0

    def begin(self, state: Floats, thrust: float, time: float, *, cause: str) -> None:
        """Start to take thrust away. state: (13,). thrust: at that time, N. time: s."""
        self.cause, self._carried_since, self._last = cause, None, time
        levelling = 0.0 if cause else tilt_of(state[ATTITUDE])
        climb_rate = float(state[VELOCITY][2])
        self._probe = GroundProbe(time, thrust, self._weight, climb_rate=climb_rate, levelling=levelling)
        self._tilting = RunningMean(STILL_TIME, float(np.linalg.norm(state[RATE][:2])))

    def command(
        self, state: Floats, meter: ForceMeter, time: float, *, current: bool, low: bool
    ) -> tuple[Floats, float, Ground]:
        """Rates, rad/s, and thrust, N, to send, and what was verdict.

        state: (13,). time: s. current: whether the state is. low: whether the height allows for the ground.
        """
        assert self._probe is not None
        attitude = state[ATTITUDE]
        self._tilting.add(float(np.linalg.norm(state[RATE][:2])), time - self._last)
        self._last = time
        if self._carried_since is None:
            climb_rate = float(state[VELOCITY][2])
            verdict = self._probe.update(meter.force, meter.thrust, attitude, time, climb_rate=climb_rate, low=low)
            if verdict is Ground.CARRIES:
                self._carried_since = time
            limit = self._rate_limit if self.cause else LEVEL_LIMIT
            rate = level_rate(attitude, gain=LEVEL_GAIN, limit=limit) if current else ZERO_RATE
            if verdict is not Ground.CARRIES:
                return rate, self._probe.thrust(time), verdict
        turning = not current or self._tilting.value > STILL  # a rate that is not known may be any
        if turning and self._carried_since is not None and time - self._carried_since < MAX_BRAKING:
            return ZERO_RATE, self._probe.thrust(time), Ground.OPEN
        return ZERO_RATE, 0.0, Ground.CARRIES

    def shut_down(self, since: float, last_thrust: float) -> float:
        """Thrust to send so many s after the end of a flight, N. last_thrust: sent before, N."""
        share = max(0.0, 1.0 - since / SHUTDOWN_TIME)
        return share * min(last_thrust, 0.5 * self._weight)
