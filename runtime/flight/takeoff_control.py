"""A take-off from the last second before the motors start to lift-off: start pose, thrust ramp, levelling. Pure."""

from __future__ import annotations

from math import degrees, radians

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, POSITION, VELOCITY
from dynamics.vehicle import Vehicle
from runtime.flight.events import Event
from runtime.flight.failsafe import level_rate
from runtime.flight.start_pose import StartPose
from runtime.flight.takeoff import TakeoffRamp
from runtime.flight.thrust import vertical

MAX_TILT_CHANGE = radians(15.0)  # change of tilt on the ground that ends a take-off
LEVELLING_SHARE = 0.6  # of the weight, from which on a take-off levels: it would leave a slope sideways
START_GAIN, START_LIMIT = 3.0, 0.5  # 1/s and rad/s, of that


class TakeoffControl:
    """Setpoints of a take-off, and the events that end it.

    ramp: of thrust.
    pose: how the vehicle stands before.
    """

    def __init__(self, vehicle: Vehicle, thrust_max: float, response_time: float) -> None:
        """thrust_max: N. response_time: s by which thrust follows its setpoint, delay included."""
        self.ramp = TakeoffRamp(vehicle.weight, thrust_max, response_time=response_time)
        self.pose = StartPose()
        self._weight = vehicle.weight

    def command(self, state: Floats, specific_force: Floats, time: float) -> tuple[Floats, float]:
        """Rates (3,) rad/s and collective thrust, N, to send. state: (13,). specific_force: (3,) m/s^2, body."""
        height, climb_rate = float(state[POSITION][2]), float(state[VELOCITY][2])
        thrust = self.ramp.update(time, height, climb_rate, vertical(specific_force, state[ATTITUDE]))
        if thrust > LEVELLING_SHARE * self._weight:
            return level_rate(state[ATTITUDE], gain=START_GAIN, limit=START_LIMIT), thrust
        return np.zeros(3), thrust

    def findings(self, state: Floats) -> dict[Event, str]:
        """Events that end the take-off, if any is present. state: (13,)."""
        present = {}
        if self.ramp.failed:
            present[Event.TAKEOFF_FAILED] = (
                f"at {self.ramp.collective_thrust:.2f} N; is it held, or a propeller missing?"
            )
        if (tilt_change := self.pose.leaning(state)) > MAX_TILT_CHANGE:
            present[Event.TIPPING] = f"by {degrees(tilt_change):.0f} degrees since the motors started"
        return present
