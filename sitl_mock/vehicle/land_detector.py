"""PX4's multicopter land detector: little thrust and no motion for a while mean ground, step by step.

Source: PX4-Autopilot, MulticopterLandDetector.cpp: ground contact, then maybe landed, then landed, each after its
share of LNDMC_TRIG_TIME (1 s); any of them ends at once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from sitl_mock.vehicle.position_control import THRUST_MIN
from sitl_mock.vehicle.vehicle_interface import MotionState

CLIMB_MAX, SPEED_MAX, RATE_MAX = 0.25, 1.5, math.radians(20.0)  # LNDMC_Z_VEL_MAX, LNDMC_XY_VEL_MAX, LNDMC_ROT_MAX
CONTACT_TIME, MAYBE_TIME, LANDED_TIME = 0.35, 0.25, 0.30  # s
LOW_THRUST, MIN_THRUST, TAKE_OFF_THRUST = 0.3, 0.05, 0.8  # of the way from THRUST_MIN to the hover thrust


@dataclass(slots=True)
class LandDetector:
    """Detects the ground in three stages; starts on the ground.

    ground_contact, maybe_landed, landed: the stages, each only after the one before.
    """

    ground_contact: bool = True
    maybe_landed: bool = True
    landed: bool = True
    _since: dict[str, float] = field(default_factory=dict)

    def update(self, time: float, now: MotionState, *, armed: bool, thrust: float, hover_thrust: float) -> None:
        """Update by the motion and the commanded thrust at a time, s. Disarmed, the vehicle counts as landed."""
        if not armed:
            self.ground_contact = self.maybe_landed = self.landed = True
            self._since.clear()
            return
        speed_x, speed_y, climb = now.velocity_world.tolist()
        rate_x, rate_y, _ = now.rate_body.tolist()
        still = abs(climb) < CLIMB_MAX and math.hypot(speed_x, speed_y) < SPEED_MAX
        quiet = math.hypot(rate_x, rate_y) < RATE_MAX
        # a landed vehicle counts as flying only when its thrust approaches the hover thrust
        low, lowest = (TAKE_OFF_THRUST, TAKE_OFF_THRUST) if self.landed else (LOW_THRUST, MIN_THRUST)
        span = hover_thrust - THRUST_MIN
        contact = still and thrust < THRUST_MIN + low * span
        self.ground_contact = self._lasting("contact", contact, time, CONTACT_TIME, self.ground_contact)
        maybe = self.ground_contact and quiet and thrust < THRUST_MIN + lowest * span
        self.maybe_landed = self._lasting("maybe", maybe, time, MAYBE_TIME, self.maybe_landed)
        self.landed = self._lasting("landed", self.maybe_landed, time, LANDED_TIME, self.landed)

    def _lasting(self, name: str, condition: bool, time: float, duration: float, was: bool) -> bool:
        if not condition:
            self._since.pop(name, None)
            return False
        return was or time - self._since.setdefault(name, time) >= duration
