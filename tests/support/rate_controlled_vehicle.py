"""A multirotor under an ideal rate loop, in lockstep with the flight logic: shared by the flight tests.

Rigid body with first-order body rates and thrust, a ground to stand on, and a planted effectiveness; it arms and
changes mode on request, and the observations show its state without a HEARTBEAT's delay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, POSITION, RATE, VELOCITY
from dynamics.vehicle import GRAVITY, Vehicle
from runtime.control.controller import Controller
from runtime.flight.decision import Decision, FlyerSettings
from runtime.flight.engagement import AutopilotRequest, State, Transition
from runtime.flight.events import Event, EventChange
from runtime.flight.flyer import Flyer
from runtime.flight.mission import Mission, Plan
from runtime.flight.motion import Motion
from runtime.flight.phases import Phase
from runtime.flight.thrust import ThrustMap
from runtime.link.estimate import StateEstimate
from runtime.record.records import ObservationRecord

PERIOD = 0.01
AGE = 0.02


class RateControlledVehicle:
    """The plant.

    effectiveness: thrust per modelled thrust.
    specific_force: (3,) m/s^2, body, mean of the last step.
    ground: height of the ground, m.
    righting: whether the ground turns the vehicle upright, as it turns legs; else it stays as it touched down.
    disturbance: (3,) m/s^2, world, of anything else that pushes.
    """

    def __init__(self, vehicle: Vehicle, thrust_map: ThrustMap, effectiveness: float = 1.0) -> None:
        self.effectiveness = effectiveness
        self.state = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        self.force = 0.0
        self.specific_force = np.array([0.0, 0.0, GRAVITY])
        self.ground, self.righting, self.disturbance = 0.0, True, np.zeros(3)
        self._mass = vehicle.body.mass
        self._map = thrust_map

    @property
    def on_ground(self) -> bool:
        """Whether it stands."""
        return bool(self.state[2] <= self.ground)

    def step(self, rate_body: Floats, thrust: float, dt: float) -> None:
        """dt seconds under a setpoint."""
        target = self.effectiveness * self._map.collective_thrust(thrust)
        self.force += (target - self.force) * min(dt / 0.04, 1.0)
        x = self.state
        x[RATE] += (rate_body - x[RATE]) * min(dt / 0.04, 1.0)
        x[ATTITUDE] = quaternion.normalise(quaternion.multiply(x[ATTITUDE], quaternion.exponential(x[RATE] * dt)))
        acceleration = quaternion.rotate(x[ATTITUDE], np.array([0.0, 0.0, self.force / self._mass])) + self.disturbance
        acceleration[2] -= GRAVITY
        before = x[VELOCITY].copy()
        if self.on_ground and (acceleration[2] <= 0.0 or x[VELOCITY][2] < 0.0):
            x[2], x[VELOCITY], x[RATE] = self.ground, 0.0, 0.0
            if self.righting:
                x[ATTITUDE] = quaternion.IDENTITY
        else:
            x[VELOCITY] += acceleration * dt
            x[POSITION] += x[VELOCITY] * dt
        felt = (x[VELOCITY] - before) / dt + np.array([0.0, 0.0, GRAVITY])
        self.specific_force = quaternion.rotate_inverse(x[ATTITUDE], felt)


@dataclass
class Story:
    """A flight, tick by tick."""

    transitions: list[Transition] = field(default_factory=list)
    event_changes: list[EventChange] = field(default_factory=list)
    phases: list[Phase] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    states: list[Floats] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    observations: list[tuple[ObservationRecord, StateEstimate | None]] = field(default_factory=list)

    @property
    def after(self) -> list[State]:
        """States entered, in order."""
        return [transition.after for transition in self.transitions]

    @property
    def raised(self) -> set[Event]:
        """Events raised."""
        return {change.event for change in self.event_changes if change.active}


class Flight:
    """Flyer and plant in lockstep; faults are planted by setting attributes between calls of `run`."""

    def __init__(
        self,
        vehicle: Vehicle,
        controller: Controller,
        reference: Motion,
        *,
        plan: Plan | None = None,
        settings: FlyerSettings | None = None,
        effectiveness: float = 1.0,
        nominal: Controller | None = None,
    ) -> None:
        self.thrust_map = ThrustMap(vehicle.rotors.thrust_max, vehicle.rotors.thrust_curve, 0.0)
        self.plant = RateControlledVehicle(vehicle, self.thrust_map, effectiveness)
        mission = Mission(vehicle, reference, plan or Plan())
        self.flyer = Flyer(vehicle, controller, mission, self.thrust_map, settings or FlyerSettings(), nominal=nominal)
        self.story = Story()
        self.time = 100.0
        self.tick = 0
        self.connected, self.armed, self.mode = True, False, "HOLD"
        self.grants: set[AutopilotRequest] = set(AutopilotRequest)
        self.findings: dict[str, str] = {}
        self.frozen = False  # no estimates arrive
        self.held_until_offboard = False  # whether the autopilot holds the vehicle where it is until then
        self.imu = True  # whether inertial samples arrive
        self.reports_landed = True  # whether the autopilot notices a landing at once
        self.slip = 0.0  # s by which estimates claim to be older than they are
        self.offset = np.zeros(3)  # of the estimator's frame
        # (9,) errors of the estimated position, velocity and attitude (rotation vector, body) at a time
        self.estimate_error: Callable[[float], Floats] = self.estimator()
        self.reset = np.zeros(3)
        self.engage, self.leave, self.stop = True, "", False
        self._past: list[tuple[float, Floats]] = []
        self._estimate: StateEstimate | None = None
        self._setpoint = (np.zeros(3), 0.0)

    def estimator(self) -> Callable[[float], Floats]:
        """Errors of the estimate where a test plants no others."""
        return lambda time: np.zeros(9)

    def run(self, seconds: float, until: Phase | State | None = None) -> Story:
        """Fly on; ends early when a phase or state is reached, or the flight is over."""
        for _ in range(round(seconds / PERIOD)):
            self._observe()
            decision = self._tick()
            self._grant(decision)
            self._act(decision)
            if until in (self.flyer.mission.phase, self.flyer.engagement.state):
                break
            if self.flyer.over and decision.transitions:
                break
        return self.story

    def _observe(self) -> None:
        self._past.append((self.time, self.plant.state.copy()))
        self._past = self._past[-20:]
        if self.frozen:
            return
        taken, state = self._past[max(0, len(self._past) - 1 - round(AGE / PERIOD))]
        state = state.copy()
        error = self.estimate_error(self.time)
        state[POSITION] += self.offset + error[0:3]
        state[VELOCITY] += error[3:6]
        state[ATTITUDE] = quaternion.multiply(state[ATTITUDE], quaternion.exponential(error[6:9]))
        self._estimate = StateEstimate(taken - self.slip, self.time, state, 0, True, "ODOMETRY")

    def _tick(self) -> Decision:
        force = self.plant.specific_force if self.imu else np.full(3, np.nan)
        observation = ObservationRecord(
            tick=self.tick,
            time=self.time,
            estimate_arrival=self._estimate.received if self._estimate else float("nan"),
            connected=self.connected,
            armed=self.armed,
            offboard=self.mode == "OFFBOARD",
            mode=self.mode,
            landed=self.plant.on_ground and (self.reports_landed or not self.armed),
            findings=msgspec.json.encode(self.findings).decode() if self.findings else "",
            reset=bool(self.reset.any()),
            reset_position=self.reset,
            reset_yaw=0.0,
            specific_force_z=float(force[2]),
            engage=self.engage,
            leave=self.leave,
            stop=self.stop,
            specific_force_xy=force[:2],
        )
        self.engage, self.reset = False, np.zeros(3)
        decision = self.flyer.step(observation, self._estimate)
        self.flyer.prepare(self.time)
        self._keep(observation, decision)
        return decision

    def _keep(self, observation: ObservationRecord, decision: Decision) -> None:
        story, mission = self.story, self.flyer.mission
        story.observations.append((observation, self._estimate))
        story.decisions.append(decision)
        story.transitions += decision.transitions
        story.event_changes += decision.event_changes
        story.times.append(self.time)
        story.states.append(self.plant.state.copy())
        if not story.phases or story.phases[-1] is not mission.phase:
            story.phases.append(mission.phase)
        if mission.phase is Phase.TRACK and (reference := self.flyer.reference_now(self.time)) is not None:
            estimated = self.plant.state[POSITION] + self.offset + self.estimate_error(self.time)[0:3]
            story.errors.append(float(np.linalg.norm(reference[POSITION] - estimated)))

    def _grant(self, decision: Decision) -> None:
        for request in self.grants.intersection(decision.requests):
            match request:
                case AutopilotRequest.OFFBOARD:
                    self.mode = "OFFBOARD"
                case AutopilotRequest.LAND:
                    self.mode = "LAND"
                case AutopilotRequest.ARM:
                    self.armed = True
                case AutopilotRequest.DISARM:
                    self.armed = False

    def _act(self, decision: Decision) -> None:
        if decision.rate_body is not None:
            assert np.all(np.isfinite(decision.rate_body))
            assert 0.0 <= decision.thrust <= 1.0
            self._setpoint = (decision.rate_body, decision.thrust)
        offboard = self.armed and self.mode == "OFFBOARD"
        rate, thrust = self._setpoint if offboard else (np.zeros(3), 0.0)
        if offboard or not self.held_until_offboard:
            self.plant.step(rate, thrust, PERIOD)
        self.time += PERIOD
        self.tick += 1
