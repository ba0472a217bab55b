"""Setpoints without a fresh solution: the chain of fallbacks and the level hold. Pure.

Each fallback is bounded: some ticks of the shifted solution, some seconds of level hold; then the stream stops and the
autopilot's own failsafe acts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from runtime.flight.contact import UP, uprightness
from runtime.flight.events import POLICIES, Event, Fallback, event_text

SUSTAINED = (Fallback.NONE, Fallback.NOMINAL_MODEL)  # what may be flown without end


class FallbackBounds(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How long each fallback may last.

    shifted_ticks: ticks of the shifted solution.
    level_hold: s.
    recovery: s without a fallback, after which both are available in full again.
    """

    shifted_ticks: int = 10
    level_hold: float = 1.0
    recovery: float = 1.0


# what may be flown under what is required, in order of preference: the nominal model flies on for as long as it takes,
# a shifted solution for some ticks, and that is still milder than to level the vehicle
_PREFERENCE: Mapping[Fallback, tuple[Fallback, ...]] = {
    Fallback.NONE: tuple(Fallback),
    Fallback.SHIFTED_SOLUTION: tuple(Fallback)[1:],
    Fallback.NOMINAL_MODEL: (
        Fallback.NOMINAL_MODEL,
        Fallback.SHIFTED_SOLUTION,
        Fallback.LEVEL_HOLD,
        Fallback.STOP_STREAMING,
    ),
    Fallback.LEVEL_HOLD: tuple(Fallback)[3:],
    Fallback.STOP_STREAMING: tuple(Fallback)[4:],
}
_WITHOUT_SOLUTION = (Fallback.SHIFTED_SOLUTION, Fallback.LEVEL_HOLD)


class FallbackChain:
    """The mildest fallback that is possible under the active events and not used up.

    current: of this tick.
    reason: why it is flown, or what last required one and is not over; empty without either.
    """

    def __init__(self, bounds: FallbackBounds) -> None:
        self._bounds = bounds
        self._shifted = 0
        self._held = 0.0
        self._last_time: float | None = None
        self._healthy_since: float | None = None
        self._active: Mapping[Event, str] = {}
        self._possible: dict[Fallback, bool] = {}
        self._uses: dict[Event, tuple[int, str]] = {}
        self.current = Fallback.NONE
        self.reason = ""

    def choose(
        self,
        active: Mapping[Event, str],
        *,
        time: float,
        estimate_usable: bool,
        solution_left: bool,
        nominal_available: bool,
    ) -> Fallback:
        """The fallback to fly now.

        active: events with their details, which require what their policies say.
        time: s.
        estimate_usable: whether there is an estimate that the nominal model can fly with.
        solution_left: whether the last prediction still covers this time.
        nominal_available: whether the controller of the vehicle file's model is ready.
        """
        elapsed = 0.0 if self._last_time is None else max(time - self._last_time, 0.0)
        self._last_time = time
        if self.current is Fallback.LEVEL_HOLD:
            self._held += elapsed
        required = max((POLICIES[event].fallback for event in active), default=Fallback.NONE)
        self._active = active
        self._refill(time)  # first: what is available again may be flown in this tick
        self._possible = {
            Fallback.NONE: True,
            Fallback.SHIFTED_SOLUTION: solution_left and self._shifted < self._bounds.shifted_ticks,
            Fallback.NOMINAL_MODEL: nominal_available and estimate_usable,
            Fallback.LEVEL_HOLD: self._held < self._bounds.level_hold,
            Fallback.STOP_STREAMING: True,
        }
        return self._take(_PREFERENCE[required])

    def replace_solution(self, event: Event, detail: str) -> Fallback:
        """The fallback of this tick after all, because the solution that was to be flown did not come."""
        self._active = {event: detail, **self._active}
        self._healthy_since = None
        return self._take((*_WITHOUT_SOLUTION, Fallback.STOP_STREAMING))

    def _take(self, preference: tuple[Fallback, ...]) -> Fallback:
        self.current = next(fallback for fallback in preference if self._possible[fallback])
        self._shifted += self.current is Fallback.SHIFTED_SOLUTION
        self.reason = self._explain()
        return self.current

    def _refill(self, time: float) -> None:
        """Make both bounded fallbacks available in full again after a time in which no event required them."""
        if any(POLICIES[event].fallback not in SUSTAINED for event in self._active):
            self._healthy_since = None
            return
        if self._healthy_since is None:
            self._healthy_since = time
        # an intermittent fault must not get a full budget with every healthy tick
        if time - self._healthy_since >= self._bounds.recovery:
            self._shifted = 0
            self._held = 0.0
            self._uses.clear()

    def _explain(self) -> str:
        """The event behind the present fallback; where a bounded one is used up, the event that used most of it."""
        cause = self._cause()
        if cause is None:
            return ""
        text = event_text(cause, self._active[cause])
        if self.current in _WITHOUT_SOLUTION:
            self._uses[cause] = (self._uses.get(cause, (0, ""))[0] + 1, self._active[cause])
        if self.current < Fallback.LEVEL_HOLD or POLICIES[cause].fallback == self.current or not self._used_up:
            return text
        spender = max(self._uses, key=lambda event: self._uses[event][0])
        if spender is cause:
            return text
        ticks, detail = self._uses[spender]
        return f"{event_text(spender, detail)} used {ticks} ticks of fallbacks up; now {text}"

    def _cause(self) -> Event | None:
        """The active event that excludes what is milder than the present fallback."""
        for fallback in (self.current, Fallback.SHIFTED_SOLUTION, Fallback.NOMINAL_MODEL):
            for event in self._active:
                if fallback is not Fallback.NONE and POLICIES[event].fallback == fallback:
                    return event
        return None

    @property
    def _used_up(self) -> bool:
        if self.current is Fallback.STOP_STREAMING:
            return self._held >= self._bounds.level_hold
        return self._shifted >= self._bounds.shifted_ticks


def level_rate(attitude: Floats, *, gain: float, limit: float) -> Floats:
    """Body rates that bring the thrust axis upright the short way, without a yaw rate.

    attitude: (4,). gain: 1/s, rate per angle. limit: rad/s. Returns (3,) rad/s, body FLU.
    """
    up_body = quaternion.rotate_inverse(attitude, UP)
    axis = np.cross(UP, up_body)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        # upside down all axes are equally short: roll
        return np.array([limit, 0.0, 0.0]) if up_body[2] < 0 else np.zeros(3)
    angle = math.atan2(sine, float(up_body[2]))
    return np.asarray(axis / sine * min(gain * angle, limit))


def level_thrust(attitude: Floats, weight: float, *, max_gain: float = 1.5) -> float:
    """Collective thrust that holds the weight at a tilt, N; 0 upside down.

    attitude: (4,). weight: N. max_gain: limit of thrust per weight, for large tilts.
    """
    cosine = uprightness(attitude)
    if cosine <= 0.0:
        return 0.0
    return weight * min(1.0 / cosine, max_gain)


class LevelHold:
    """Brings the vehicle upright from its last known attitude, assuming that it follows the rates sent."""

    def __init__(self, weight: float, *, gain: float = 3.0, limit: float = 2.0) -> None:
        """weight: N. gain: 1/s. limit: rad/s."""
        self._weight = weight
        self._gain = gain
        self._limit = limit
        self._attitude = quaternion.IDENTITY

    def observe(self, attitude: Floats) -> None:
        """Take a current attitude. attitude: (4,)."""
        self._attitude = attitude

    def command(self, duration: float) -> tuple[Floats, float]:
        """Rates (3,) rad/s and collective thrust, N, to send for the next `duration` s without an attitude."""
        rate = level_rate(self._attitude, gain=self._gain, limit=self._limit)
        thrust = level_thrust(self._attitude, self._weight)
        rotated = quaternion.multiply(self._attitude, quaternion.exponential(rate * duration))
        self._attitude = quaternion.normalise(rotated)
        return rate, thrust
