"""Health checks of a flight: age of the estimate, allowed box, thrust at its limit, rates not followed."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.rate_loop import rate_loop
from dynamics.state import POSITION, RATE
from dynamics.vehicle import Vehicle
from runtime.flight.events import Event
from runtime.link.estimate import StateEstimate
from runtime.link.start_conditions import estimator_doubts, estimator_rejections
from runtime.link.telemetry import EstimatorSample
from runtime.running_mean import RunningMean

# limits as shares of the largest body rate; measured on a vehicle of 12 rad/s (benchmarks/results/oscillation.md)
UNFOLLOWED, SWING, CHATTER = 1 / 4, 1 / 6, 1 / 8
BLOW = 2.0  # times `unfollowed`, up to which an error of body rates counts for it
FROZEN = 0.1  # s of one and the same estimate


class HealthLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of the health checks. `swing` and `chatter` replace a learned model before the loop diverges.

    stale: s without an estimate.
    oldest: s, age of an estimate, because of the link's delay or a clock that slipped.
    margin: m outside of the box beyond which control is given up.
    unfollowed: rad/s, mean error of body rates against their setpoints beyond which control is given up.
    following_time: s, time constant of that mean.
    rate_delay: s after which body rates have followed their setpoints.
    swing: rad/s, mean error of body rates against a learned model's setpoints.
    chatter: rad/s, mean second difference of a learned model's setpoints from tick to tick (norm).
    swing_time: s, time constant of these two means.
    """

    stale: float = 0.06
    oldest: float = 0.12
    margin: float = 2.0
    unfollowed: float = 3.0
    following_time: float = 1.0
    rate_delay: float = 0.06
    swing: float = 2.0
    chatter: float = 1.5
    swing_time: float = 0.5

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, catalogue: Mapping[str, Effect] = CATALOGUE) -> HealthLimits:
        """Limits relative to the vehicle's largest body rate, and the delay of its rate loop."""
        rate = max(vehicle.limits.rate)
        return cls(
            unfollowed=UNFOLLOWED * rate,
            rate_delay=vehicle.controller.delay + rate_loop(vehicle, catalogue=catalogue).tilt_time,
            swing=SWING * rate,
            chatter=CHATTER * rate,
        )


def estimator_health(status: EstimatorSample) -> dict[Event, str]:
    """Events of what the estimator reports of itself in flight."""
    present: dict[Event, str] = {}
    if doubts := estimator_doubts(status):
        present[Event.ESTIMATOR_DEGRADED] = f"it {doubts[0]}"
    if rejections := estimator_rejections(status):
        present[Event.ESTIMATOR_REJECTS] = f"it {rejections}"
    return present


class FrozenEstimate:
    """Whether estimates stay the same to the last bit while the accelerometer's samples change."""

    def __init__(self) -> None:
        self._state: Floats | None = None
        self._force: Floats = np.full(3, np.nan)
        self._since: float | None = None

    def update(self, estimate: StateEstimate, specific_force: Floats) -> dict[Event, str]:
        """The event, if they do. estimate: the newest. specific_force: (3,) m/s^2, body; NaN without a measurement."""
        changed = bool(np.any(specific_force != self._force)) and np.isfinite(specific_force[2])
        if self._state is None or not np.array_equal(estimate.state, self._state):
            self._state, self._since = estimate.state, None
        elif changed and self._since is None:
            self._since = estimate.time
        self._force = specific_force
        duration = 0.0 if self._since is None else estimate.time - self._since
        return {Event.ESTIMATE_FROZEN: f"the same to the last bit for {duration:.1f} s"} if duration > FROZEN else {}


class FlightHealth:
    """Events that a flight's states and setpoints show. Pure: time is an argument, s."""

    def __init__(self, vehicle: Vehicle, limits: HealthLimits | None = None) -> None:
        self.limits = limits or HealthLimits()
        self._box = vehicle.limits.box
        self._thrust_max = vehicle.thrust_limits[1]
        self._thrust = 0.0
        self._sent: deque[tuple[float, Floats]] = deque(maxlen=64)
        self._reset()

    def _reset(self) -> None:
        self._restart_means()
        self._chatter = RunningMean(self.limits.swing_time, 0.0)
        self._miss_time: float | None = None

    def _restart_means(self) -> None:
        limits = self.limits
        self._miss, self._swing = RunningMean(limits.following_time, 0.0), RunningMean(limits.swing_time, 0.0)
        self._compared_for = 0.0

    def sent(self, rate_body: Floats, collective_thrust: float, time: float) -> None:
        """Add a setpoint that was sent. rate_body: (3,) rad/s. collective_thrust: N. time: s."""
        self._thrust = collective_thrust
        if len(self._sent) > 1:
            (_, oldest), (before, last) = self._sent[-2], self._sent[-1]
            self._chatter.add(float(np.linalg.norm(rate_body - 2 * last + oldest)), time - before)
        self._sent.append((time, rate_body))

    @property
    def oscillation(self) -> tuple[float, float]:
        """Second difference of setpoints from tick to tick, and error of rates against them; running means, rad/s."""
        return self._chatter.value, self._swing.value

    def rest(self) -> None:
        """Forget the setpoints, as while nothing is streamed."""
        self._sent.clear()
        self._reset()
        self._thrust = 0.0

    def is_current(self, estimate: StateEstimate, time: float) -> bool:
        """Whether an estimate is young enough for the model to predict the present state from it."""
        return time - estimate.received <= self.limits.stale and time - estimate.time <= self.limits.oldest

    def estimate_age(self, estimate: StateEstimate | None, time: float) -> dict[Event, str]:
        """The event of stale estimates, if they are. estimate: the newest, None before the first."""
        if estimate is None:
            return {Event.ESTIMATE_STALE: "none has arrived yet"}
        if self.is_current(estimate, time):
            return {}
        silence = time - estimate.received
        if silence > self.limits.stale:
            return {Event.ESTIMATE_STALE: f"none for {1e3 * silence:.0f} ms"}
        return {Event.ESTIMATE_STALE: f"the newest is {1e3 * (time - estimate.time):.0f} ms old"}

    def flight(self, state: Floats, time: float, *, learned: bool = False) -> dict[Event, str]:
        """Events that a fresh state (13,) of a flying vehicle shows. learned: whether a learned model flies it."""
        present = self._position(state[POSITION])
        if self._thrust > 0.99 * self._thrust_max:
            present[Event.THRUST_LIMIT] = f"{self._thrust:.2f} of {self._thrust_max:.2f} N"
        self._compare(state[RATE], time)
        if self._miss.value > self.limits.unfollowed and self._compared_for >= self.limits.following_time:
            detail = f"body rates miss their setpoints by {self._miss.value:.1f} rad/s on average"
            present[Event.SETPOINT_REFUSED] = detail
        chatter, swing = self.oscillation
        if learned and chatter > self.limits.chatter:
            present[Event.MODEL_OSCILLATES] = f"setpoints alternate by {chatter:.1f} rad/s from tick to tick"
        elif learned and swing > self.limits.swing:
            present[Event.MODEL_OSCILLATES] = f"body rates miss its setpoints by {swing:.1f} rad/s"
        return present

    def _position(self, position: Floats) -> dict[Event, str]:
        if self._box is None:
            return {}
        low, high = (np.array(corner) for corner in self._box)
        outside = float(np.max(np.maximum(low - position, position - high)))
        if outside <= 0:
            return {}
        event = Event.GEOFENCE if outside <= self.limits.margin else Event.GEOFENCE_LEFT
        return {event: f"{outside:.1f} m outside of the box"}

    def _compare(self, rate_body: Floats, time: float) -> None:
        setpoint = next((rate for at, rate in reversed(self._sent) if at <= time - self.limits.rate_delay), None)
        if setpoint is None:
            return
        elapsed = 0.0 if self._miss_time is None else time - self._miss_time
        if elapsed > self.limits.stale:  # nothing is known of the time between: the means begin again
            self._restart_means()
            elapsed = 0.0
        self._miss_time = time
        self._compared_for += elapsed
        miss = float(np.linalg.norm(rate_body - setpoint))
        # a blow that the vehicle takes up within a moment is no refusal
        self._miss.add(min(miss, BLOW * self.limits.unfollowed), elapsed)
        self._swing.add(miss, elapsed)
