"""Setpoints without a fresh solution: the chain of fallbacks and the level hold. Pure.

Each fallback is bounded: some ticks of the shifted solution, some seconds of level hold; then the stream stops and the
autopilot's own failsafe acts.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from runtime.flight.events import Fallback

UP = np.array([0.0, 0.0, 1.0])


class FallbackBounds(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How long each fallback may last.

    shifted_ticks: ticks of the shifted solution.
    level_hold: s.
    recovery: s without a fallback, after which both are available in full again.
    """

    shifted_ticks: int = 10
    level_hold: float = 1.0
    recovery: float = 1.0


class FallbackChain:
    """Escalates from the fallback that the events require to one that is available and not used up."""

    def __init__(self, bounds: FallbackBounds) -> None:
        self._bounds = bounds
        self._shifted = 0
        self._held = 0.0
        self._last_time: float | None = None
        self._healthy_since: float | None = None
        self.current = Fallback.NONE

    def choose(
        self, required: Fallback, *, time: float, estimate_usable: bool, solution_left: bool, nominal_available: bool
    ) -> Fallback:
        """The fallback to fly now: the mildest possible one from the required one on.

        time: s.
        estimate_usable: whether there is an estimate that the nominal model can fly with.
        solution_left: whether the last prediction still covers this time.
        nominal_available: whether the controller of the vehicle file's model is ready.
        """
        elapsed = 0.0 if self._last_time is None else max(time - self._last_time, 0.0)
        self._last_time = time
        if required is Fallback.NONE:
            self._refill(time)
            self.current = Fallback.NONE
            return self.current
        self._healthy_since = None
        if self.current is Fallback.LEVEL_HOLD:
            self._held += elapsed
        possible = {
            Fallback.SHIFTED_SOLUTION: solution_left and self._shifted < self._bounds.shifted_ticks,
            Fallback.NOMINAL_MODEL: nominal_available and estimate_usable,
            Fallback.LEVEL_HOLD: self._held < self._bounds.level_hold,
            Fallback.STOP_STREAMING: True,
        }
        self.current = next(fallback for fallback, can in possible.items() if fallback >= required and can)
        self._shifted += self.current is Fallback.SHIFTED_SOLUTION
        return self.current

    def _refill(self, time: float) -> None:
        if self._healthy_since is None:
            self._healthy_since = time
        # an intermittent fault must not get a full budget with every healthy tick
        if time - self._healthy_since >= self._bounds.recovery:
            self._shifted = 0
            self._held = 0.0


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
    cosine = float(quaternion.rotate(attitude, UP)[2])
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
