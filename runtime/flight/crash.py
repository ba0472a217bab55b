"""A flight that has met something, from the force that nothing in flight explains and from what was requested. Pure."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import degrees, radians

import numpy as np

from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from runtime.flight.contact import ForceMeter, Persistence, tilt_of
from runtime.flight.events import Event


@dataclass(frozen=True)
class CrashLimits:
    """Limits no healthy flight exceeds, even with a wrong model (benchmarks/results/crash_detector.md).

    impact: m/s^2, change of the external force within `impact_time`; air cannot change it so fast.
    impact_time: s.
    carried: of the weight, external force upward at low speed.
    pressed: of the weight, external force downward at low speed.
    per_thrust: of the change or excess of thrust, by which its model may be wrong; added to the three.
    slow: m/s, an estimated speed at rest.
    carried_time, pressed_time: s.
    tilt: rad, and `excess`: rad beyond the reference, both of which no manoeuvre exceeds for `tilt_time`, s.
    returning: rad by which the tilt has fallen from its largest where a vehicle is turning back to level.
    distance: m from the reference for `distance_time`, s.
    """

    impact: float = 0.9 * GRAVITY
    impact_time: float = 0.2
    carried: float = 0.4
    pressed: float = 0.4
    per_thrust: float = 0.3
    slow: float = 1.2
    carried_time: float = 0.3
    pressed_time: float = 0.7
    tilt: float = radians(100.0)
    excess: float = radians(60.0)
    tilt_time: float = 0.3
    returning: float = radians(15.0)
    distance: float = 3.0
    distance_time: float = 1.0


class CrashDetector:
    """Events of a flight that has met something, from the external force and from what was requested."""

    def __init__(self, limits: CrashLimits | None = None) -> None:
        self.limits = limits or CrashLimits()
        self.reset()

    def reset(self) -> None:
        """Forget everything, as when the controller starts."""
        limits = self.limits
        self._past: deque[tuple[float, Floats, float]] = deque()
        self._carried, self._pressed = Persistence(limits.carried_time), Persistence(limits.pressed_time)
        self._tilted, self._far = Persistence(limits.tilt_time), Persistence(limits.distance_time)
        self._largest_tilt = 0.0

    def force(self, meter: ForceMeter, velocity: Floats, time: float) -> dict[Event, str]:
        """Events of the external force. velocity: (3,) m/s, estimated. time: s."""
        limits, force, thrust = self.limits, meter.force, meter.thrust
        present: dict[Event, str] = {}
        if not force.covered:
            self._past.clear()
            return present
        jump = self._jump(meter.explained_by_no_loss, thrust, time)
        if jump > limits.impact:
            present[Event.IMPACT] = f"an unexplained {jump / GRAVITY:.1f} g within {limits.impact_time:g} s"
        slow = float(np.linalg.norm(velocity)) < limits.slow
        allowance = limits.per_thrust * max(thrust - GRAVITY, 0.0)
        if self._carried.update(slow and meter.carrying > limits.carried * GRAVITY + allowance, time):
            present[Event.GROUND_CONTACT] = f"it carries {meter.carrying / GRAVITY:.0%} of the weight"
        lacking = meter.lacking
        allowance = limits.per_thrust * max(thrust + lacking + force.up - GRAVITY, 0.0)
        if self._pressed.update(slow and lacking > limits.pressed * GRAVITY + allowance, time):
            present[Event.HELD] = f"{lacking / GRAVITY:.0%} of the weight is missing in its motion"
        return present

    def motion(self, attitude: Floats, reference: Floats, distance: float, time: float) -> dict[Event, str]:
        """Events of the motion. attitude, reference: (4,). distance: m from the reference. time: s."""
        limits = self.limits
        present: dict[Event, str] = {}
        tilt, requested = tilt_of(attitude), tilt_of(reference)
        beyond = tilt > max(limits.tilt, requested + limits.excess)
        self._largest_tilt = max(tilt, self._largest_tilt) if beyond else 0.0
        returning = tilt < self._largest_tilt - limits.returning
        if self._tilted.update(beyond and not returning, time):
            detail = f"{degrees(tilt):.0f} degrees, {degrees(requested):.0f} were requested"
            present[Event.OVERTURNED] = detail
        if self._far.update(distance > limits.distance, time):
            present[Event.TRACKING_LOST] = f"{distance:.1f} m from it for {limits.distance_time:g} s"
        return present

    def _jump(self, value: Floats, thrust: float, time: float) -> float:
        """Change of the external force since `impact_time` ago, less what a change of thrust may explain, m/s^2."""
        limits = self.limits
        self._past.append((time, value, thrust))
        while len(self._past) > 1 and self._past[1][0] <= time - limits.impact_time:
            self._past.popleft()
        before, then, _ = self._past[0]
        if before > time - limits.impact_time:
            return 0.0
        thrusts = [past[2] for past in self._past]
        change = float(np.linalg.norm(value - then))
        return change - limits.per_thrust * (max(thrusts) - min(thrusts))
