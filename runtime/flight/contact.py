"""Contact with the ground or an obstacle, from the force that neither thrust nor gravity explains. Pure.

Neither the estimated height nor the climb rate tells where the ground is: the estimate drifts by decimetres and goes on
drifting at rest. The accelerometer does not: whatever carries the vehicle shows in it at once.
"""

from __future__ import annotations

from collections import deque
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
SETTLED = 0.15  # of the weight, force along the thrust up to which thrust is as modelled
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
        self._upright, self._missing, self._axis = 1.0, 0.0, UP
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
        self._missing, self._axis = max(missing_thrust, 0.0), np.asarray(quaternion.rotate(attitude, UP))
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

    @property
    def lacking(self) -> float:
        """Vertical part of the thrust that was there at lift-off and moves nothing now, m/s^2."""
        return self._missing * self._upright - self.force.up

    @property
    def explained_by_no_loss(self) -> Floats:
        """(3,) the force without the part against the thrust, which may be thrust that is lost, m/s^2, world."""
        return self.force.value - min(self.force.along_thrust, 0.0) * self._axis

    @property
    def unexplained(self) -> Floats:
        """(3,) change from the usual force that no loss of thrust explains, m/s^2, world."""
        return self.explained_by_no_loss - self.usual

    def learn(self, duration: float) -> None:
        """Take the present force as a usual one of free flight, for `duration` s.

        Not while thrust does not do what is modelled: what lacks of it is no force from outside that goes on.
        """
        if self.force.covered and abs(self.force.along_thrust) < SETTLED * GRAVITY:
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
    PER_THRUST, CHANGE_TIME = 0.3, 0.15  # of a change of thrust within s, by which its model may be late
    USUAL_CHANGE = 0.3 * GRAVITY  # m/s^2, of a descent
    IMPULSE, IMPULSE_FAST = 0.25, 0.5  # of the weight over MEAN_TIME: a descent of 0.25 and 0.5 m/s that ends

    def __init__(self) -> None:
        self._slow, self._fast = Persistence(self.HOLD), Persistence(self.HOLD)
        self._thrusts: deque[tuple[float, float]] = deque()

    def update(self, meter: ForceMeter, time: float, *, slow: bool) -> bool:
        """Take one tick. slow: whether the descent is slower than 0.4 m/s. time: s."""
        change = meter.unexplained
        anywhere = self.SIDEWAYS * float(np.linalg.norm(change)) if meter.force.covered else 0.0
        allowance = self.PER_THRUST * max(self._thrust_change(meter.thrust, time) - self.USUAL_CHANGE, 0.0)
        share = (max(meter.force.along_thrust, float(change[2]), anywhere) - allowance) / GRAVITY
        held_slow = self._slow.update(share > self.SHARE, time)
        held_fast = self._fast.update(share > self.SHARE_FAST, time)
        return held_fast or share > self.IMPULSE_FAST or (slow and (held_slow or share > self.IMPULSE))

    def _thrust_change(self, thrust: float, time: float) -> float:
        """Between the greatest and the smallest thrust of the last moments, m/s^2: its model lags or leads."""
        thrusts = self._thrusts
        thrusts.append((time, thrust))
        while thrusts[0][0] < time - self.CHANGE_TIME:
            thrusts.popleft()
        values = [value for _, value in thrusts]
        return max(values) - min(values)
