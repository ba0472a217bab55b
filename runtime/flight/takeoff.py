"""Take-off and landing: thrust ramp, bumpless hand-over, landing detection. Pure.

In OFFBOARD the autopilot does not spool up: the first setpoint after arming reaches the motors within tens of
milliseconds. So thrust rises slowly until the vehicle lifts off, and only then the controller takes over.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import isfinite, nan

from dynamics.vehicle import GRAVITY

RECENT = 0.1  # s over which the specific force is averaged at lift-off


@dataclass(frozen=True)
class RampSettings:
    """The thrust ramp of a take-off.

    rise: s from zero thrust to the weight.
    spool: initial thrust per weight.
    max_thrust: per weight.
    patience: s at the maximum thrust without lift-off.
    height: m above the lowest estimate of the ramp, since one that sinks at rest hides a lift-off; it requires more
        than that and than the climb rate.
    smoothing: s, of that estimate: noise is no sinking.
    climb_rate: m/s.
    force: specific force along body z over gravity, mean over force_time, s, which lift-off requires more than where it
        is measured: an estimate that drifts upward at rest is no lift-off.
    """

    rise: float = 1.5
    spool: float = 0.1
    max_thrust: float = 1.6
    patience: float = 1.0
    height: float = 0.04
    smoothing: float = 0.2
    climb_rate: float = 0.15
    force: float = 1.07
    force_time: float = 0.3


class TakeoffRamp:
    """Raises the thrust until the vehicle leaves the ground.

    lifted: whether it has lifted off.
    failed: whether it has not, for longer than the patience at the maximum thrust.
    collective_thrust: the present setpoint, N.
    """

    def __init__(self, weight: float, thrust_max: float, settings: RampSettings | None = None) -> None:
        """weight, thrust_max: N."""
        self._settings = settings or RampSettings()
        self._weight = weight
        self._max_thrust = min(self._settings.max_thrust * weight, 0.95 * thrust_max)
        self._started: float | None = None
        self._last = 0.0
        self._ground = self._smooth = 0.0
        self._rising = 0
        self._forces: deque[tuple[float, float]] = deque()
        self._lift_height = 0.0
        self._lift_rate = 0.0
        self.lifted = False
        self.failed = False
        self.collective_thrust = 0.0

    def update(self, time: float, height: float, climb_rate: float, specific_force: float = nan) -> float:
        """Thrust setpoint at this time, N.

        height: m, climb_rate: m/s, both world up. specific_force: along body z, m/s^2; NaN where none is new.
        """
        settings = self._settings
        if isfinite(specific_force):
            self._forces.append((time, specific_force))
        while self._forces and self._forces[0][0] < time - settings.force_time:
            self._forces.popleft()
        if self._started is None:
            self._started = self._last = time
            self._ground = self._smooth = height
        if self.lifted:
            return self.collective_thrust
        self._smooth += min((time - self._last) / settings.smoothing, 1.0) * (height - self._smooth)
        self._ground, self._last = min(self._ground, self._smooth), time
        elapsed = time - self._started
        ramp = (settings.spool + (1 - settings.spool) * elapsed / settings.rise) * self._weight
        self.collective_thrust = min(ramp, self._max_thrust)
        rising = height - self._ground > settings.height and climb_rate > settings.climb_rate
        self._rising = self._rising + 1 if rising else 0
        self._lift_height, self._lift_rate = height - self._ground, climb_rate
        # one estimate may be noise; below half the weight nothing lifts off
        pushed = self._is_pushed
        self.lifted = self._rising >= 3 and self.collective_thrust > 0.5 * self._weight and pushed
        time_at_max_thrust = settings.rise * (self._max_thrust / self._weight - settings.spool) / (1 - settings.spool)
        self.failed = not self.lifted and elapsed > time_at_max_thrust + settings.patience
        return self.collective_thrust

    @property
    def _is_pushed(self) -> bool:
        """Whether the vehicle accelerates upward; true where nothing measures it."""
        if not self._forces:
            return True
        mean = sum(force for _, force in self._forces) / len(self._forces)
        return mean > self._settings.force * GRAVITY

    def effectiveness(self, response_time: float) -> float:
        """Thrust per modelled thrust at lift-off: by the accelerometer, or by the estimate where none is measured.

        By the estimate: while thrust rises steadily, height grows with the cube and climb rate with the square of the
        time since the vehicle left the ground, so that time is 3 height / climb rate. An estimate that drifted at rest
        makes it too long. response_time: s by which thrust follows its setpoint.
        """
        settings = self._settings
        slope = 0.0
        if self.collective_thrust < self._max_thrust:
            slope = (1 - settings.spool) * self._weight / settings.rise
        if self._forces:
            newest = self._forces[-1][0]
            recent = [force for time, force in self._forces if time > newest - RECENT]
            lag = 0.5 * RECENT + response_time
            force = sum(recent) / len(recent) / GRAVITY * self._weight
            return force / max(self.collective_thrust - slope * lag, 0.3 * self._weight)
        since = min(3 * self._lift_height / max(self._lift_rate, settings.climb_rate), 1.0) + response_time
        return self._weight / max(self.collective_thrust - slope * since, 0.3 * self._weight)


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
