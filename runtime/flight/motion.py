"""Motions in time: what every phase of a flight tracks, as states and rotor speeds. Pure.

A motion has the methods of a Reference of `dynamics.references`, so that the controller's window is read the same way
in every phase.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.references.curve import rest_to_rest
from dynamics.references.flatness import flat_motion
from dynamics.state import ATTITUDE, POSITION, RIGID_BODY_STATES, VELOCITY
from dynamics.vehicle import Vehicle


class Motion(Protocol):
    """A motion, in time since its start, s. The arrays are the caller's, which may change them."""

    @property
    def duration(self) -> float:
        """Time until it rests, s; infinite if it never does."""
        ...

    def states(self, times: Floats) -> Floats:
        """(n, 13) position and velocity (world), attitude, body rates."""
        ...

    def inputs(self, times: Floats) -> Floats:
        """(n, rotors) rotor speeds, rad/s."""
        ...


class Moved:
    """A motion at another place."""

    def __init__(self, motion: Motion, by: Floats) -> None:
        """by: (3,) m."""
        self._motion, self._by = motion, by

    @property
    def duration(self) -> float:
        """Time until it rests, s; infinite if it never does."""
        return self._motion.duration

    def states(self, times: Floats) -> Floats:
        """(n, 13) position and velocity (world), attitude, body rates."""
        result = self._motion.states(times)
        result[:, POSITION] += self._by
        return result

    def inputs(self, times: Floats) -> Floats:
        """(n, rotors) rotor speeds, rad/s."""
        return self._motion.inputs(times)


class Transfer:
    """A straight motion from rest to rest between two poses; tabulated on construction."""

    def __init__(self, vehicle: Vehicle, start: Floats, end: Floats, duration: float) -> None:
        """start, end: (4,) x, y, z in m and yaw in rad. duration: s."""
        self.start, self.end, self.duration = start, end, duration
        # linear interpolation over 20 ms errs by 0.1 mm at 2 m/s^2; building 500 rows costs less than a millisecond
        rows = int(min(max(duration / 0.02, 1.0), 500.0)) + 1
        times = np.linspace(0.0, duration, rows)
        flat = rest_to_rest(np.array([start, end]), np.array([duration])).derivatives(times)
        motion = flat_motion(times, flat, vehicle)
        self._states = np.hstack([motion.position, motion.velocity, motion.attitude, motion.rate_body])
        self._inputs = motion.rotor_speed

    def states(self, times: Floats) -> Floats:
        """(n, 13) position and velocity (world), attitude, body rates."""
        result = self._read(self._states, times)
        result[:, ATTITUDE] /= np.sqrt(np.sum(result[:, ATTITUDE] ** 2, axis=1))[:, None]
        return result

    def inputs(self, times: Floats) -> Floats:
        """(n, rotors) rotor speeds, rad/s."""
        return self._read(self._inputs, times)

    def _read(self, table: Floats, times: Floats) -> Floats:
        place = np.clip(times * ((len(table) - 1) / self.duration), 0.0, len(table) - 1.000001)
        row = place.astype(np.intp)
        return np.asarray(table[row] + (place - row)[:, None] * (table[row + 1] - table[row]))


class Descent:
    """Straight down at a constant speed, without end: the landing detector ends it."""

    duration = math.inf

    def __init__(self, vehicle: Vehicle, start: Floats, speed: float) -> None:
        """start: (4,) x, y, z in m and yaw in rad. speed: m/s."""
        self._speed = speed
        self._hover_speed = vehicle.hover_speed
        self._rotors = vehicle.rotors.count
        self.start = start
        self._attitude = quaternion.from_euler(0.0, 0.0, start[3])

    def states(self, times: Floats) -> Floats:
        """(n, 13) position and velocity (world), attitude, body rates."""
        result = np.zeros((times.size, RIGID_BODY_STATES))
        result[:, POSITION] = self.start[:3]
        result[:, POSITION][:, 2] -= self._speed * np.maximum(times, 0.0)
        result[:, VELOCITY][:, 2] = -self._speed
        result[:, ATTITUDE] = self._attitude
        return result

    def inputs(self, times: Floats) -> Floats:
        """(n, rotors) rotor speeds, rad/s."""
        return np.full((times.size, self._rotors), self._hover_speed)
