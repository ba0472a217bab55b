"""The last step of a setpoint: the vehicle's limits, and thrust in the autopilot's 0..1; the memory of it. Pure."""

from __future__ import annotations

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle
from runtime.flight.decision import Decision
from runtime.flight.events import Event
from runtime.flight.takeoff import HandOver
from runtime.flight.thrust import EffectivenessEstimator, EffectivenessSettings, ThrustMap
from runtime.link.estimate import StateEstimate

MIN_THRUST = 1.08  # of the weight, at most available, with which a flight goes on


class SetpointOutput:
    """Limits setpoints, converts their thrust by the present effectiveness, and keeps the last one.

    thrust_map: between the autopilot's thrust and N.
    effectiveness: thrust per modelled thrust.
    hand_over: transition to the controller's thrust, None before the first.
    last_thrust: collective thrust of the last setpoint, N.
    """

    def __init__(self, vehicle: Vehicle, thrust_map: ThrustMap, settings: EffectivenessSettings) -> None:
        self.thrust_map = thrust_map
        self.effectiveness = EffectivenessEstimator(vehicle.body.mass, settings)
        self.hand_over: HandOver | None = None
        self.last_thrust = 0.0
        self._vehicle = vehicle
        self._rate_limit, self._thrust_limit = vehicle.limits.rate, vehicle.thrust_limits[1]
        self._sent: tuple[Floats, float, float, float] | None = None

    @property
    def available_thrust(self) -> float:
        """The greatest collective thrust by the present effectiveness, N."""
        return min(self._thrust_limit, self.effectiveness.value * self.thrust_map.thrust_max)

    def measure(self, estimate: StateEstimate, force: Floats, along: float, *, near_ground: bool) -> dict[Event, str]:
        """Update the effectiveness by a fresh estimate. Returns the event of too little thrust, if that is left.

        force: (3,) specific force, m/s^2, body. along: that along body z, without drag. near_ground: whether a landing
        may be near the ground.
        """
        velocity = estimate.velocity_world
        climb = float(quaternion.rotate_inverse(estimate.attitude, velocity)[2])
        speed, sideways = float(np.linalg.norm(velocity)), (float(force[0]), float(force[1]))
        self.effectiveness.measure(along, estimate.time, speed, climb=climb, sideways=sideways, landing=near_ground)
        pushed = self._vehicle.body.mass * float(np.linalg.norm(self.effectiveness.across))
        if (left := (self.available_thrust + pushed) / self._vehicle.weight) < MIN_THRUST:
            return {Event.THRUST_LOST: f"at most {left:.2f} of the weight"}
        return {}

    def finish(self, decision: Decision, rate_body: Floats, held: float, time: float) -> None:
        """Complete a decision. rate_body: (3,) rad/s. held: thrust that may be held afterwards, N. time: s."""
        limited = zip(rate_body.tolist(), self._rate_limit, strict=True)
        decision.rate_body = np.array([min(max(rate, -limit), limit) for rate, limit in limited])
        decision.collective_thrust = min(max(decision.collective_thrust, 0.0), self._thrust_limit)
        decision.thrust = self.thrust_map.setpoint(decision.collective_thrust, self.effectiveness.value)
        decision.held_thrust = self.thrust_map.setpoint(held, self.effectiveness.value)
        self.last_thrust = decision.collective_thrust
        self._sent = (decision.rate_body, decision.collective_thrust, decision.thrust, time)

    def departed(self) -> tuple[Floats, float, float, float] | None:
        """The setpoint that has left since the last call, once: rates, collective thrust, N, thrust 0..1, time, s."""
        sent, self._sent = self._sent, None
        if sent is not None:
            self.effectiveness.command(self.thrust_map.collective_thrust(sent[2]), sent[3])
        return sent
