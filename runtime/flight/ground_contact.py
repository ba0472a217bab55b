"""Ground contact by the external force: a landing, a collision, or no ground below. Pure."""

from __future__ import annotations

from collections import deque

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, POSITION, VELOCITY
from dynamics.vehicle import Vehicle
from runtime.flight.contact import MEAN_TIME, ForceMeter, LandingContact
from runtime.flight.crash import CrashDetector
from runtime.flight.events import Event
from runtime.flight.mission import Mission
from runtime.flight.phases import Path, PhasePolicy
from runtime.flight.takeoff import LandingDetector
from runtime.link.estimate import StateEstimate

TOUCHDOWN_PATIENCE = 30.0  # s of descending at touch-down speed
SLOW_DESCENT = 0.4  # m/s
LOW = 1.8  # m over the place of take-off by the estimate, off by 1.5 m at worst, below which there may be ground
STRUCK = 1.5  # m/s of sinking, beyond any touch-down, that ends on something
SINKING_TIME = 0.3  # s over which it counts


class GroundContact:
    """The external force of a flight and what follows from it, phase by phase.

    meter: of the external force.
    struck: m/s at which the vehicle has hit the ground; 0 for no faster than a landing does.
    """

    def __init__(self, vehicle: Vehicle, period: float) -> None:
        """period: of the control thread, s."""
        self.meter = ForceMeter()
        self._period = period
        self._contact, self._crash = LandingContact(), CrashDetector()
        self._standing = LandingDetector(vehicle.weight)
        self._reference: Floats | None = None
        self._touch_down_since: float | None = None
        self._climb_rates: deque[tuple[float, float]] = deque()
        self.struck = 0.0

    def clear(self) -> None:
        """Start again, as on the ground."""
        self.meter.clear()
        self._crash.reset()
        self._climb_rates.clear()
        self.struck = 0.0

    def measure(
        self,
        mission: Mission,
        estimate: StateEstimate,
        reference: Floats | None,
        specific_force: Floats,
        thrust: float,
        time: float,
        *,
        missing_thrust: float = 0.0,
    ) -> dict[Event, str]:
        """Take one tick of a flight. Returns the events of a crash that force and motion show.

        reference: its state (13,) at this time, None where none is tracked. specific_force: (3,) m/s^2, body.
        thrust: modelled, per mass, m/s^2. time: s. missing_thrust: lost since lift-off, per mass, m/s^2.
        """
        self._reference = reference
        velocity = (estimate.time, estimate.velocity_world)
        self.meter.update(specific_force, thrust, estimate.attitude, velocity, time, missing_thrust=missing_thrust)
        self._feel_blow(float(estimate.velocity_world[2]), time)
        grace = mission.policy.grace
        if reference is None or (grace and time - mission.phase_started <= grace):
            self._crash.reset()
            return {}
        self.meter.learn(self._period)
        distance = 0.0
        if mission.policy.path is not Path.STOP:  # its reference is where the vehicle will come to rest
            distance = float(np.linalg.norm(estimate.position_world - reference[POSITION]))
        present = self._crash.force(self.meter, estimate.velocity_world, time)
        return present | self._crash.motion(estimate.attitude, reference[ATTITUDE], distance, time)

    def _feel_blow(self, climb_rate: float, time: float) -> None:
        """Note how fast the vehicle was sinking when something stopped it. climb_rate: m/s. time: s."""
        rates = self._climb_rates
        rates.append((time, climb_rate))
        while rates[0][0] < time - SINKING_TIME:
            rates.popleft()
        sinking = -min(rate for _, rate in rates)
        if sinking > STRUCK and self.meter.force.up * MEAN_TIME > 0.5 * STRUCK:
            self.struck = max(self.struck, sinking)

    @property
    def blow(self) -> str:
        """The blow with which the vehicle reached the ground, in words; empty after a landing."""
        return f"it hit the ground at {self.struck:.1f} m/s" if self.struck else ""

    @staticmethod
    def may_be_near(mission: Mission, state: Floats, *, reported_landed: bool) -> bool:
        """Whether the estimated height, or the autopilot, allows for the ground. state: (13,)."""
        height = mission.height(state)
        return reported_landed or height is None or height < LOW

    def has_landed(
        self, policy: PhasePolicy, state: Floats, collective_thrust: float, time: float, *, reported_landed: bool
    ) -> bool:
        """Whether a landing has reached the ground.

        policy: of the present phase. state: (13,). collective_thrust: setpoint, N. time: s.
        reported_landed: by the autopilot.
        """
        if not policy.lands:
            self._touch_down_since = None
            return False
        touching_down = policy.path is Path.DOWN
        if touching_down and self._touch_down_since is None:
            self._touch_down_since = time
        reported = reported_landed and touching_down
        climb_rate = float(state[VELOCITY][2])
        still = self._standing.update(time, climb_rate, collective_thrust, reported_landed=reported)
        slow = touching_down or (self._reference is not None and self._reference[VELOCITY][2] > -SLOW_DESCENT)
        return self._contact.update(self.meter, time, slow=slow) or still

    def missing_ground(self, time: float) -> dict[Event, str]:
        """The event of a touch-down that takes too long, if it does. time: s."""
        if self._touch_down_since is None or time - self._touch_down_since <= TOUCHDOWN_PATIENCE:
            return {}
        return {Event.SETPOINT_REFUSED: f"no ground after {TOUCHDOWN_PATIENCE:g} s of descent"}
