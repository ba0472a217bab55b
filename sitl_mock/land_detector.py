"""PX4's multicopter land detector: little thrust and no motion for a while mean ground, step by step.

Source: PX4-Autopilot, MulticopterLandDetector.cpp: ground contact, then maybe landed, then landed, each after its
share of LNDMC_TRIG_TIME (1 s); any of them ends at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sitl_mock.vehicle_interface import MotionState

CLIMB_MAX, SPEED_MAX, TURN_MAX = 0.25, 1.5, math.radians(20.0)  # LNDMC_Z_VEL_MAX, LNDMC_XY_VEL_MAX, LNDMC_ROT_MAX
CONTACT_TIME, MAYBE_TIME, LANDED_TIME = 0.35, 0.25, 0.30  # s
LOW_THRUST, LEAST_THRUST = 0.3, 0.1  # of the hover thrust
START_UP_TIME = 2.0  # s after arming in which a rotor may not have taken up its load


@dataclass(slots=True)
class LandDetector:
    """ground_contact, maybe_landed, landed: what is believed. Starts on the ground."""

    ground_contact: bool = True
    maybe_landed: bool = True
    landed: bool = True
    _since: dict[str, float] = field(default_factory=dict)

    def update(self, time: float, now: MotionState, *, armed: bool, thrust: float, hover_thrust: float) -> None:
        """Look at the motion and the thrust asked for at a time, s. Disarmed, the vehicle counts as landed."""
        if not armed:
            self.ground_contact = self.maybe_landed = self.landed = True
            self._since.clear()
            return
        still = abs(now.velocity_world[2]) < CLIMB_MAX and bool(np.hypot(*now.velocity_world[0:2]) < SPEED_MAX)
        quiet = bool(np.hypot(*now.rate_body[0:2]) < TURN_MAX)
        contact = still and thrust < LOW_THRUST * hover_thrust + self._bonus(hover_thrust)
        self.ground_contact = self._lasting("contact", contact, time, CONTACT_TIME, self.ground_contact)
        maybe = self.ground_contact and still and quiet and thrust < LEAST_THRUST * hover_thrust + self._bonus(hover_thrust)
        self.maybe_landed = self._lasting("maybe", maybe, time, MAYBE_TIME, self.maybe_landed)
        self.landed = self._lasting("landed", self.maybe_landed, time, LANDED_TIME, self.landed)

    def _bonus(self, hover_thrust: float) -> float:
        """On the ground the thrust at which a vehicle counts as flying is higher: nothing flies below it."""
        return 0.5 * hover_thrust if self.landed else 0.0

    def _lasting(self, name: str, condition: bool, time: float, duration: float, was: bool) -> bool:
        if not condition:
            self._since.pop(name, None)
            return False
        return was or time - self._since.setdefault(name, time) >= duration
