"""Whether the ground carries a vehicle, found out by taking thrust away from it. Pure."""

from __future__ import annotations

from enum import Enum

from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from runtime.flight.contact import ExternalForce, Persistence, uprightness
from runtime.flight.thrust import MAX_FILE_ERROR


class Ground(Enum):
    """Result of a probe of the ground."""

    OPEN = "open"
    CARRIES = "carries"
    ABSENT = "absent"


class GroundProbe:
    """Reduces thrust after a contact, level, and finds out whether the ground carries the vehicle.

    Two signs have to agree that it does. The accelerometer: on the ground the vertical specific force stays gravity's
    while thrust goes away, in the air it goes away with thrust. The estimate: the vehicle does not fall while thrust
    lacks. Neither needs to know what the force was in flight, and both hold for any effectiveness that a file can be
    wrong by. Higher above the place of take-off than an estimate drifts, and without the autopilot's own detection of
    the ground, both must last. Thrust never goes below the floor meanwhile, so that a gust that was mistaken for the
    ground, or a bounce, costs a moment of reduced thrust, and the vehicle is caught.
    """

    RAMP = 0.15  # s in which thrust goes to the floor
    FIRST = 0.6  # thrust per weight at once: enough to level with
    LEVELLING, MAX_LEVELLING = 1.5, 0.4  # rad/s; s for which that thrust is kept in a landing
    FLOOR = 0.3  # thrust per weight
    MIN_DEFICIT = 0.3  # of the weight that the force which would keep it at rest must be to judge the ground
    DOUBT = MAX_FILE_ERROR  # factor by which the modelled thrust may be too small
    CARRIED, FALLING = 0.6, 0.3  # shares of the force that would keep it at rest which something else gives
    HOLD, HOLD_HIGH = 0.04, 0.3  # s that a sign must hold; where the height speaks against the ground
    MAX_SINKING = 1.2  # m/s, of an estimate whose velocity errs by 0.8 m/s at rest, at which nothing carries
    FALLEN, DOUBTFUL_FALL = 0.5, 0.15  # share of a fall without ground, and m/s, that shows it
    PATIENCE = 0.8  # s after which the likelier counts

    def __init__(self, time: float, thrust: float, weight: float, *, climb_rate: float, levelling: float) -> None:
        """time: s. thrust: at that time, N. weight: N. climb_rate: m/s then, estimated.

        levelling: rad by which it leans, for which thrust is kept for a while; 0 in flight.
        """
        self._started, self._last = time, time
        self._ramp = time + min(levelling / self.LEVELLING, self.MAX_LEVELLING)
        self._first, self._floor = min(thrust, self.FIRST * weight), self.FLOOR * weight
        self._climb_rate, self._expected = climb_rate, 0.0
        self._carried, self._lasting = Persistence(self.HOLD), Persistence(self.HOLD_HIGH)
        self._falling = Persistence(self.HOLD)

    def thrust(self, time: float) -> float:
        """Thrust to send, N."""
        away = min(max((time - self._ramp) / self.RAMP, 0.0), 1.0)
        return self._first + away * (min(self._floor, self._first) - self._first)

    def update(
        self, force: ExternalForce, thrust: float, attitude: Floats, time: float, *, climb_rate: float, low: bool
    ) -> Ground:
        """Take one tick.

        thrust: modelled, per mass, m/s^2. attitude: (4,). time: s. climb_rate: estimated, m/s. low: whether the height
        over the place of take-off, or the autopilot, allows for the ground.
        """
        lift = thrust * uprightness(attitude)
        deficit = GRAVITY - lift
        self._expected += max(deficit, 0.0) * (time - self._last)
        self._last = time
        sinks = climb_rate < -self.MAX_SINKING  # steadily, where air drag carries a part
        falls = sinks or self._climb_rate - climb_rate > self.FALLEN * self._expected + self.DOUBTFUL_FALL
        judged = force.covered and deficit > self.MIN_DEFICIT * GRAVITY
        felt = force.up + lift
        greatest_lift = max(lift, 0.0) * self.DOUBT
        certain = judged and felt - greatest_lift > self.CARRIED * max(
            GRAVITY - greatest_lift, self.MIN_DEFICIT * GRAVITY
        )
        carried = self._carried.update(certain and not falls, time)
        lasting = self._lasting.update(certain and not falls, time)
        if (carried if low else lasting) and time >= self._ramp:  # levelled
            return Ground.CARRIES
        if self._falling.update(sinks or (judged and force.up < self.FALLING * deficit), time):
            return Ground.ABSENT
        if time - self._started > self.PATIENCE:
            doubtful = judged and force.up < 0.5 * (self.CARRIED + self.FALLING) * deficit
            return Ground.ABSENT if falls or doubtful else Ground.CARRIES
        return Ground.OPEN
