"""Take-off and landing: thrust ramp, bumpless hand-over, landing detection. Pure.

In OFFBOARD the autopilot does not spool up: the first setpoint after arming reaches the motors within tens of
milliseconds. So thrust rises slowly until the vehicle lifts off, and only then the controller takes over.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan

from runtime.flight.lift_off import NEVER, LiftOffEvidence
from runtime.flight.thrust import MAX_FILE_ERROR, MIN_FILE_ERROR

RESPONSE_TIME = 0.07  # s by which thrust follows its setpoint, delay included


@dataclass(frozen=True)
class RampSettings:
    """The thrust ramp of a take-off.

    rise: s from zero thrust to the weight.
    spool: initial thrust per weight.
    max_thrust: per weight; what the vehicle needs whose file is as wrong as it can be.
    patience: s at the maximum thrust without lift-off. An estimate that rises then is waited for, and as long again
        it is one, whatever the accelerometer shows of a thrust that hardly lifts: to end it in the air is worse.
    height: m above the lowest estimate of the ramp, since one that sinks at rest hides a lift-off; it requires more
        than that and than the climb rate.
    smoothing: s, of that estimate: noise is no sinking.
    climb_rate: m/s.
    evidence: log likelihood ratio of the accelerometer's samples that lift-off requires beside it, where they are
        measured; and `certain`, which suffices alone.
    """

    rise: float = 1.5
    spool: float = 0.1
    max_thrust: float = 1.05 / MIN_FILE_ERROR
    patience: float = 1.0
    height: float = 0.04
    smoothing: float = 0.2
    climb_rate: float = 0.15
    evidence: float = 12.0
    certain: float = 30.0


class TakeoffRamp:
    """Raises the thrust until the vehicle leaves the ground.

    lifted: whether it has lifted off.
    failed: whether it has not, for longer than the patience at the maximum thrust.
    collective_thrust: the present setpoint, N.
    """

    def __init__(
        self,
        weight: float,
        thrust_max: float,
        settings: RampSettings | None = None,
        *,
        response_time: float = RESPONSE_TIME,
    ) -> None:
        """weight, thrust_max: N. response_time: s by which thrust follows its setpoint, delay included."""
        self._settings = settings or RampSettings()
        self._weight = weight
        self._max_thrust = min(self._settings.max_thrust * weight, 0.95 * thrust_max)
        self._started: float | None = None
        self._last = self._elapsed = 0.0
        self._ground = self._smooth = 0.0
        self._rising, self._rising_since = 0, 0.0
        self._response_time = response_time
        self._evidence = LiftOffEvidence(weight)
        self._lift_height = 0.0
        self._lift_rate = 0.0
        self.lifted = False
        self.failed = False
        self.collective_thrust = 0.0

    def update(self, time: float, height: float, climb_rate: float, specific_force: float = nan) -> float:
        """Thrust setpoint at this time, N.

        height: m, climb_rate: m/s, both world up. specific_force: vertical, m/s^2; NaN where none is new.
        """
        settings = self._settings
        if self._started is None:
            self._started = self._last = time
            self._ground = self._smooth = height
        if self.lifted:
            return self.collective_thrust
        self._elapsed = elapsed = time - self._started
        if isfinite(specific_force):
            self._evidence.add(time, self._thrust_at(elapsed - self._response_time), specific_force)
        self._smooth += min((time - self._last) / settings.smoothing, 1.0) * (height - self._smooth)
        self._ground, self._last = min(self._ground, self._smooth), time
        self.collective_thrust = self._thrust_at(elapsed)
        rising = height - self._ground > settings.height and climb_rate > settings.climb_rate
        self._rising = self._rising + 1 if rising else 0  # one estimate may be noise
        self._rising_since = self._rising_since if self._rising > 1 else time
        self._lift_height, self._lift_rate = height - self._ground, climb_rate
        carried = self.collective_thrust * MAX_FILE_ERROR > self._weight
        time_at_max_thrust = settings.rise * (self._max_thrust / self._weight - settings.spool) / (1 - settings.spool)
        overdue = elapsed > time_at_max_thrust + settings.patience
        rises_on = overdue and rising and time - self._rising_since >= settings.patience
        self.lifted = carried and (self._has_left(rising=self._rising >= 3) or rises_on)
        self.failed = overdue and not (self.lifted or rising)
        return self.collective_thrust

    def _thrust_at(self, elapsed: float) -> float:
        """Setpoint at a time since the start, s, in N."""
        settings = self._settings
        share = settings.spool + (1 - settings.spool) * max(elapsed, 0.0) / settings.rise
        return min(share * self._weight, self._max_thrust)

    def _has_left(self, *, rising: bool) -> bool:
        """Whether accelerometer and estimate agree that it has left the ground, or the former is certain."""
        if not self._evidence.measured:
            return rising
        ratio, settings = self._evidence.ratio, self._settings
        return ratio > settings.certain or (rising and ratio > settings.evidence)

    @property
    def effectiveness(self) -> float:
        """Thrust per modelled thrust at lift-off: by the accelerometer, or by the estimate where none is measured.

        By the estimate: while thrust rises steadily, height grows with the cube and climb rate with the square of the
        time since the vehicle left the ground, so that time is 3 height / climb rate. An estimate that drifted at rest
        makes it too long.
        """
        settings = self._settings
        if self._evidence.measured and self._evidence.ratio > NEVER:
            return self._evidence.effectiveness
        since = min(3 * self._lift_height / max(self._lift_rate, settings.climb_rate), 1.0) + self._response_time
        value = self._weight / max(self._thrust_at(self._elapsed - since), 0.3 * self._weight)
        return min(max(value, MIN_FILE_ERROR), MAX_FILE_ERROR)


@dataclass(frozen=True)
class HandOver:
    """A transition from one thrust to the controller's without a step.

    started: s. collective_thrust: N, then. duration: s.
    """

    started: float
    collective_thrust: float
    duration: float = 0.4

    def blend(self, controller_thrust: float, time: float) -> float:
        """Thrust to send, N."""
        part = min(max((time - self.started) / self.duration, 0.0), 1.0)
        share = part * part * (3 - 2 * part)
        return self.collective_thrust + share * (controller_thrust - self.collective_thrust)


class LandingDetector:
    """Whether a descending vehicle stands on the ground."""

    def __init__(self, weight: float, *, climb_rate: float = 0.12, thrust: float = 0.75, hold: float = 0.5) -> None:
        """weight: N. climb_rate: m/s, upper bound. thrust: per weight, upper bound. hold: s that both must hold."""
        self._weight = weight
        self._climb_rate = climb_rate
        self._thrust = thrust
        self._hold = hold
        self._since: float | None = None

    def update(self, time: float, climb_rate: float, collective_thrust: float, *, reported_landed: bool) -> bool:
        """Take one tick. climb_rate: m/s. collective_thrust: setpoint, N. reported_landed: by the autopilot."""
        if reported_landed:
            return True
        standing = abs(climb_rate) < self._climb_rate and collective_thrust < self._thrust * self._weight
        if not standing:
            self._since = None
        elif self._since is None:
            self._since = time
        return self._since is not None and time - self._since >= self._hold
