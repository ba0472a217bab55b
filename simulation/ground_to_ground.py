"""A whole flight in lockstep, from the ground and back to it: take-off, reference, landing, disarming.

The runtime's own logic on the mock's vehicle in one process, in simulated time, without a link. The autopilot is
reduced to what a landing meets of it: OFFBOARD and arming are granted, disarming is refused at first, a change of mode
takes the vehicle away. Same inputs, same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynamics.arrays import Floats
from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.vehicle import EffectUse, Vehicle
from runtime.flight.composition import Controllers, build_flyer
from runtime.flight.contact import tilt_of
from runtime.flight.engagement import AutopilotRequest, EngagementSettings
from runtime.flight.flyer import Decision, Flyer, FlyerSettings
from runtime.flight.health import HealthLimits
from runtime.flight.mission import Phase, Plan
from runtime.flight.motion import Motion
from runtime.link.estimate import StateEstimate
from runtime.record.records import ObservationRecord
from simulation.lockstep import LATENCY
from sitl_mock.vehicle.vehicle import SimulatedVehicle, VehicleOptions
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint

IDLE = ControlSetpoint("rates", rate_body=np.zeros(3), thrust=0.0)
STREAM_TIME = 1.2  # s, also the time for which the vehicle stands before it arms
DISARM_REPLY = 0.1  # s from a request to the answer


@dataclass(frozen=True, eq=False)
class FlownTick:
    """What one tick shows: true height above the ground's origin, m, true tilt, rad, share of the weight carried."""

    time: float
    phase: Phase
    height: float
    tilt: float
    carried: float
    thrust: float
    armed: bool


@dataclass(eq=False)
class WholeFlight:
    """The flight, tick by tick.

    events: (time, name, detail) of each that was raised.
    outcome: why it ended.
    """

    ticks: list[FlownTick] = field(default_factory=list)
    events: list[tuple[float, str, str]] = field(default_factory=list)
    outcome: str = ""
    landing_reason: str = ""

    def times(self, name: str) -> list[float]:
        """When an event was raised, s."""
        return [time for time, event, _ in self.events if event == name]


class GroundToGround:
    """A vehicle, its flight logic, and the autopilot between them."""

    def __init__(
        self,
        vehicle: Vehicle,
        controllers: Controllers,
        reference: Motion,
        plan: Plan,
        *,
        effects: Sequence[EffectUse] = (),
        options: VehicleOptions | None = None,
        seed: int = 0,
        refusals: int = 0,
    ) -> None:
        """effects: hidden from the controller. refusals: requests to disarm that the autopilot refuses."""
        self.plant = SimulatedVehicle(vehicle, effects=effects, options=options, seed=seed)
        settings = FlyerSettings(
            period=CONTROL_PERIOD,
            engagement=EngagementSettings(stream_time=STREAM_TIME),
            health=HealthLimits.for_vehicle(vehicle),
        )
        curve = self.plant.tuning.thrust_model_factor
        self.flyer: Flyer = build_flyer(controllers, reference, plan, settings, thrust_curve=curve)
        self.flight = WholeFlight()
        self.leave = ""
        self.inertial = True
        self._refusals, self._armed, self._mode = refusals, False, "HOLD"
        self._setpoint, self._tick = IDLE, 0
        self._disarm_at = float("inf")

    def fly(self, patience: float, watch: Callable[[GroundToGround], None] | None = None) -> WholeFlight:
        """Fly until it is over. patience: s of simulated time. watch: called before each tick, to plant a fault."""
        self.plant.advance(IDLE, False, 0.5)
        while self.plant.time < patience and not self.flyer.over:
            if watch is not None:
                watch(self)
            self._step()
        self.flight.outcome = self.flyer.engagement.refusal or "not over"
        self.flight.landing_reason = self.flyer.mission.landing_reason
        return self.flight

    def _step(self) -> None:
        now = round(1000 * self.plant.time) / 1000  # whole milliseconds: stamps of equal instants have equal bits
        decision = self._decide(now)
        self._grant(decision, now)
        following = IDLE
        if self._armed and self._mode == "OFFBOARD" and decision.rate_body is not None:
            following = ControlSetpoint("rates", rate_body=decision.rate_body, thrust=decision.thrust)
        self.plant.advance(self._setpoint, self._armed, LATENCY)
        self.plant.advance(following, self._armed, CONTROL_PERIOD - LATENCY)
        self._setpoint, self._tick = following, self._tick + 1

    def _decide(self, now: float) -> Decision:
        plant, state = self.plant, self.plant.estimate
        parts = [state.position_world, state.velocity_world, state.attitude, state.rate_body]
        estimate = StateEstimate(round(1000 * state.time) / 1000, now, np.concatenate(parts), 0, True, "ODOMETRY")
        force = plant.imu.specific_force_body if self.inertial else np.full(3, np.nan)
        observation = ObservationRecord(
            tick=self._tick,
            time=now,
            estimate_arrival=now,
            connected=True,
            armed=self._armed,
            offboard=self._mode == "OFFBOARD",
            mode=self._mode,
            landed=plant.on_ground,
            findings="",
            reset=False,
            reset_position=np.zeros(3),
            reset_yaw=0.0,
            specific_force_z=float(force[2]),
            specific_force_xy=np.array(force[:2]),
            engage=self._tick == 0,
            leave=self.leave,
        )
        decision = self.flyer.step(observation, estimate)
        self.flyer.prepare(now)
        self._keep(decision, now)
        return decision

    def _keep(self, decision: Decision, now: float) -> None:
        truth = self.plant.truth
        thrust = decision.collective_thrust if decision.rate_body is not None else 0.0
        row = (self.flyer.mission.phase, float(truth.position_world[2]), tilt_of(truth.attitude))
        self.flight.ticks.append(FlownTick(now, *row, self.plant.ground_force, thrust, self._armed))
        raised = [change for change in decision.event_changes if change.active]
        self.flight.events += [(change.time, change.event.value, change.detail) for change in raised]

    def _grant(self, decision: Decision, now: float) -> None:
        for request in decision.requests:
            match request:
                case AutopilotRequest.OFFBOARD:
                    self._mode = "OFFBOARD"
                case AutopilotRequest.LAND:
                    self._mode = "LAND"
                case AutopilotRequest.ARM:
                    self._armed = True
                case AutopilotRequest.DISARM if self._refusals > 0:
                    self._refusals -= 1
                case AutopilotRequest.DISARM:
                    self._disarm_at = now + DISARM_REPLY
        if now >= self._disarm_at:
            self._armed, self._disarm_at = False, float("inf")


def after_contact(flight: WholeFlight, threshold: float = 0.05) -> tuple[float, Floats, Floats]:
    """The last contact: its time, s, and from then on the times, s, and true tilts, rad.

    threshold: share of the weight that the ground carries from the contact on.
    """
    airborne = [tick.carried < threshold and tick.armed and tick.height > 0.0 for tick in flight.ticks]
    first = int(np.flatnonzero(airborne)[-1]) + 1 if any(airborne) else 0
    after = flight.ticks[min(first, len(flight.ticks) - 1) :]
    return after[0].time, np.array([tick.time for tick in after]), np.array([tick.tilt for tick in after])
