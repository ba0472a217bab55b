"""Contact with the ground or an obstacle, from the force that neither thrust nor gravity explains. Pure.

Neither the estimated height nor the climb rate tells where the ground is: the estimate drifts by decimetres and goes on
drifting at rest. The accelerometer does not: whatever carries the vehicle shows in it at once.
"""

from __future__ import annotations

from collections import deque
from enum import Enum
from math import acos, inf, isfinite

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY

UP = np.array([0.0, 0.0, 1.0])
GRAVITY_WORLD = np.array([0.0, 0.0, GRAVITY])
MEAN_TIME = 0.1  # s over which the force is averaged: it takes PX4's 1.4 m/s^2 of noise at 100 Hz down to 0.45
USUAL_TIME = 1.5  # s over which the usual force of a flight is averaged
MIN_UPRIGHTNESS = 0.1  # cosine of the tilt, below which a thrust shows nothing vertical
MAX_GAP = 0.2  # s between two samples after which the mean starts again


def uprightness(attitude: Floats) -> float:
    """Cosine of the tilt: the share of a thrust along body z that is vertical. attitude: (4,)."""
    return min(max(float(quaternion.rotate(attitude, UP)[2]), -1.0), 1.0)


def tilt_of(attitude: Floats) -> float:
    """Angle of the body's z axis to the vertical, rad. attitude: (4,)."""
    return acos(uprightness(attitude))


class ExternalForce:
    """The mean force besides thrust and gravity over the last tenth of a second, per mass, m/s^2, world axes.

    value: (3,), zero until the samples cover the time.
    along_thrust: its part along the body's z axis, m/s^2, which a thrust that was fitted in the same wind has none of.
    covered: whether they do.
    """

    def __init__(self) -> None:
        self._samples: deque[tuple[float, Floats, float]] = deque()
        self.clear()

    def clear(self) -> None:
        """Forget all samples."""
        self._samples.clear()
        self.value, self.along_thrust, self.covered = np.zeros(3), 0.0, False

    def add(self, time: float, specific_force: Floats, thrust: float, attitude: Floats) -> None:
        """Add a sample.

        time: s. specific_force: (3,) m/s^2, body; NaN for an axis that is not measured, which counts as free of force.
        thrust: along body z, per mass, m/s^2. attitude: (4,).
        """
        if self._samples and time - self._samples[-1][0] > MAX_GAP:
            self.clear()
        body = np.nan_to_num(specific_force)
        body[2] -= thrust
        self._samples.append((time, np.asarray(quaternion.rotate(attitude, body)), float(body[2])))
        while self._samples[0][0] <= time - MEAN_TIME:
            self._samples.popleft()
        count = len(self._samples)
        span = (time - self._samples[0][0]) * count / max(count - 1, 1)  # each sample stands for its period
        self.covered = span > 0.7 * MEAN_TIME
        if self.covered:
            self.value = np.mean([sample for _, sample, _ in self._samples], axis=0)
            self.along_thrust = sum(axial for _, _, axial in self._samples) / len(self._samples)

    def expire(self, time: float) -> None:
        """Forget samples of a stream that has stopped. time: s."""
        if self._samples and time - self._samples[-1][0] > MAX_GAP:
            self.clear()

    @property
    def up(self) -> float:
        """Its vertical part, m/s^2."""
        return float(self.value[2])


class ForceMeter:
    """Measures the external force by the accelerometer, or by the estimated velocity where no accelerometer is sent.

    force: the running mean.
    usual: (3,) the mean over the last seconds of flight, m/s^2, world: drag in the wind, and what a thrust that was
        fitted in it leaves.
    thrust: the modelled collective thrust at the last update, per mass, m/s^2.
    by_velocity: whether the last sample is from the estimated velocity.
    """

    def __init__(self) -> None:
        self.force = ExternalForce()
        self.clear()

    def clear(self) -> None:
        """Start again, as on the ground."""
        self.force.clear()
        self.usual = np.zeros(3)
        self.thrust, self.by_velocity = 0.0, False
        self._upright, self._missing = 1.0, 0.0
        self._measured, self._before = -inf, (0.0, np.zeros(3))

    def update(
        self,
        specific_force: Floats,
        thrust: float,
        attitude: Floats,
        velocity: tuple[float, Floats],
        time: float,
        *,
        missing_thrust: float = 0.0,
    ) -> None:
        """Take one tick.

        specific_force: (3,) m/s^2, body, NaN where none is new. thrust: modelled, per mass, m/s^2. attitude: (4,).
        velocity: time of the newest estimate, s, and its velocity, (3,) m/s. time: s.
        missing_thrust: what the model has lost of it since lift-off, per mass, m/s^2.
        """
        self.thrust, self._upright = thrust, max(uprightness(attitude), MIN_UPRIGHTNESS)
        self._missing = max(missing_thrust, 0.0)
        (before, velocity_before), self._before = self._before, velocity
        elapsed = velocity[0] - before
        if isfinite(specific_force[2]):
            self._measured, self.by_velocity = time, False
            self.force.add(time, specific_force, thrust, attitude)
        elif time - self._measured > MAX_GAP and 1e-3 < elapsed < MAX_GAP:
            self.by_velocity = True
            world = (velocity[1] - velocity_before) / elapsed + GRAVITY_WORLD
            self.force.add(time, np.asarray(quaternion.rotate_inverse(attitude, world)), thrust, attitude)
        self.force.expire(time)

    @property
    def carrying(self) -> float:
        """Vertical part of the force that carries the vehicle, m/s^2, in any case.

        A wind from the side that passed for missing thrust leaves a force across the thrust, which points upwards: as
        much of it as thrust has gone missing in flight does not count, unless it is along the thrust as well.
        """
        assured = self.force.up - self._missing * self._upright
        return min(self.force.up, max(assured, self.force.along_thrust / self._upright))

    def learn(self, duration: float) -> None:
        """Take the present force as a usual one of free flight, for `duration` s."""
        if self.force.covered:
            self.usual += (self.force.value - self.usual) * min(duration / USUAL_TIME, 1.0)


class Persistence:
    """Whether a condition has held without a break for some time. duration: s."""

    def __init__(self, duration: float) -> None:
        self._duration = duration
        self._since: float | None = None

    def update(self, condition: bool, time: float) -> bool:
        """Take the condition at a time, s."""
        if not condition:
            self._since = None
        elif self._since is None:
            self._since = time
        return self._since is not None and time - self._since >= self._duration


class LandingContact:
    """Whether a descending vehicle has reached the ground: an impulse upward, or a part of its weight carried.

    Both need more in a fast descent, in which air drag carries a part as well. A wrong alarm costs a moment of reduced
    thrust (see GroundProbe), a missed contact a vehicle that chases its drifting estimate on the ground.
    """

    SHARE, SHARE_FAST, HOLD = 0.2, 0.35, 0.1  # of the weight; s
    SIDEWAYS = 0.6  # the part of a force in any direction that counts: friction holds a vehicle that leans in wind
    IMPULSE, IMPULSE_FAST = 0.25, 0.5  # of the weight over MEAN_TIME: a descent of 0.25 and 0.5 m/s that ends

    def __init__(self) -> None:
        self._slow, self._fast = Persistence(self.HOLD), Persistence(self.HOLD)

    def update(self, meter: ForceMeter, time: float, *, slow: bool) -> bool:
        """Take one tick. slow: whether the descent is slower than 0.4 m/s. time: s."""
        change = meter.force.value - meter.usual
        anywhere = self.SIDEWAYS * float(np.linalg.norm(change)) if meter.force.covered else 0.0
        share = max(meter.force.along_thrust, float(change[2]), anywhere) / GRAVITY
        held_slow = self._slow.update(share > self.SHARE, time)
        held_fast = self._fast.update(share > self.SHARE_FAST, time)
        return held_fast or share > self.IMPULSE_FAST or (slow and (held_slow or share > self.IMPULSE))


class Ground(Enum):
    """What a probe of the ground has found."""

    OPEN = "open"
    CARRIES = "carries"
    ABSENT = "absent"


class GroundProbe:
    """Takes thrust away after a contact, level, and finds out whether the ground carries the vehicle.

    On the ground the specific force stays gravity's while thrust goes away; in the air it goes away with thrust, down
    to what was usual in flight. So a gust that was mistaken for the ground, or a bounce, costs a moment of reduced
    thrust, and the vehicle is caught.
    """

    RAMP = 0.3  # s in which thrust goes away
    FIRST = 0.6  # thrust per weight at once: enough to level with
    LEVELLING, MAX_LEVELLING = 1.5, 0.4  # rad/s; s for which that thrust is kept in a landing
    FLOOR = 0.3  # thrust per weight, to which a probe in flight reduces it
    MIN_DEFICIT = 0.3  # of the weight that the force which would keep it at rest must be to judge the ground
    CARRIED, FALLING = 0.6, 0.3  # shares of the force that would keep it at rest which something else gives
    HOLD = 0.04  # s that either must hold
    PATIENCE = 0.8  # s after which the likelier of the two counts

    def __init__(
        self, time: float, thrust: float, weight: float, *, tilt: float, landing: bool, usual: Floats | None = None
    ) -> None:
        """time: s. thrust: at that time, N. weight: N. tilt: rad. landing: whether thrust may go to zero meanwhile.

        usual: (3,) external force of the flight before, m/s^2, world: a wind goes on in the air. None for none.
        """
        self._usual = np.zeros(3) if usual is None else usual
        levelling = min(tilt / self.LEVELLING, self.MAX_LEVELLING) if landing else 0.0
        self._started, self._ramp = time, time + levelling
        self._first = min(thrust, self.FIRST * weight)
        self._floor = 0.0 if landing else self.FLOOR * weight
        self._carried, self._falling = Persistence(self.HOLD), Persistence(self.HOLD)

    def thrust(self, time: float) -> float:
        """Thrust to send, N."""
        return max(self._first * min(1.0 - (time - self._ramp) / self.RAMP, 1.0), self._floor)

    def update(self, force: ExternalForce, thrust: float, attitude: Floats, time: float) -> Ground:
        """Take one tick. thrust: modelled, per mass, m/s^2. attitude: (4,). time: s."""
        lacking = GRAVITY_WORLD - thrust * quaternion.rotate(attitude, UP) - self._usual
        deficit = float(np.linalg.norm(lacking))
        judged = force.covered and deficit > self.MIN_DEFICIT * GRAVITY
        share = float((force.value - self._usual) @ lacking) / deficit**2 if judged else 0.0
        carried = self._carried.update(judged and share > self.CARRIED, time)
        if carried and time >= self._ramp:  # levelled
            return Ground.CARRIES
        if self._falling.update(judged and share < self.FALLING, time):
            return Ground.ABSENT
        if time - self._started > self.PATIENCE:
            return Ground.CARRIES if share > 0.5 * (self.CARRIED + self.FALLING) or not judged else Ground.ABSENT
        return Ground.OPEN
