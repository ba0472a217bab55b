"""Whole flights in lockstep: the runtime's flight logic and the mock's autopilot in one process, ground to ground.

As over a link, but without one: the autopilot's rules decide on arming, mode and disarming, estimates come when PX4
sends them (every second or third of its steps of 4 ms), with the estimator's errors and faults. Same inputs, same bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.references import Reference
from dynamics.state import POSITION
from dynamics.vehicle_file import read_vehicle
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight.composition import Controllers, build_flyer
from runtime.flight.engagement import AutopilotRequest
from runtime.flight.flyer import Decision, Flyer, FlyerSettings
from runtime.flight.health import HealthLimits
from runtime.flight.mission import Phase, Plan
from runtime.link.estimate import EstimateCheck, EstimateMonitor, ResetStep, StateEstimate
from runtime.link.odometry import Odometry
from runtime.record.records import ObservationRecord
from runtime.telemetry_buffer import LINK_EVENTS
from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.modes import Mode
from sitl_mock.mock import MockOptions, build_autopilot
from sitl_mock.vehicle.vehicle import SimulatedVehicle
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, MotionState
from sitl_mock.wire.motion_messages import LOCAL_NED
from sitl_mock.wire.streams import TOLERANCE

LATENCY = 0.003  # s from an estimate to the setpoint's arrival
WAITING = 3.0  # s that the vehicle stands before it is engaged
ALOFT = (Phase.APPROACH, Phase.TRACK, Phase.BRAKE, Phase.RETURN, Phase.DESCEND)
NO_STEP = ResetStep(np.zeros(3), np.zeros(3), 0.0)
CLOSE = 0.1  # m from the ground, below which a vehicle that lands has arrived


@dataclass
class WholeFlight:
    """A flight from the ground to the ground, and what was true in it. Times are simulated, s.

    landed: whether the flight ended by the runtime's own landing.
    outcome: why it ended.
    time: (ticks,) of each tick.
    truth, estimate: (ticks, 13) rigid-body states.
    reference: (ticks, 3) position of the reference in the estimator's frame, m; NaN where none is tracked.
    phases: (ticks,) of the mission.
    events: raised, in order.
    ground_force: (ticks,) share of the weight that the ground carries.
    clearance: (ticks,) distance of the feet from the ground, m.
    refused: requests to disarm that the autopilot refused.
    disarmed: when the motors stopped for good; NaN if they did not.
    """

    landed: bool = False
    outcome: str = ""
    time: list[float] = field(default_factory=list)
    truth: list[Floats] = field(default_factory=list)
    estimate: list[Floats] = field(default_factory=list)
    reference: list[Floats] = field(default_factory=list)
    phases: list[Phase] = field(default_factory=list)
    events: list[str] = field(default_factory=list)
    ground_force: list[float] = field(default_factory=list)
    clearance: list[float] = field(default_factory=list)
    refused: int = 0
    disarmed: float = float("nan")

    @property
    def contact(self) -> int:
        """The tick from which the vehicle stays close to the ground; the number of ticks if it never flew or landed."""
        flying = np.flatnonzero(np.array(self.clearance) > CLOSE)
        return int(flying[-1]) + 1 if flying.size else len(self.time)

    @property
    def touched_in_flight(self) -> bool:
        """Whether it touched the ground between take-off and landing."""
        aloft = [phase in ALOFT for phase in self.phases]
        return bool(np.any(np.array(self.ground_force)[aloft] > 0.0))

    @property
    def tilt_after_contact(self) -> float:
        """Greatest true tilt from the last contact on, rad; NaN without one."""
        attitudes = np.array([state[6:10] for state in self.truth[self.contact :]])
        return float(tilts(attitudes).max()) if attitudes.size else float("nan")

    def tracking_error(self, states: Sequence[Floats]) -> float:
        """RMS distance of `truth` or `estimate` from the reference while it is tracked, m; NaN if it never was."""
        tracked = np.array([phase is Phase.TRACK for phase in self.phases])
        if not tracked.any():
            return float("nan")
        away = np.array([state[POSITION] for state in states])[tracked] - np.array(self.reference)[tracked]
        return float(np.sqrt(np.nanmean(np.sum(away**2, axis=1))))


def tilts(attitudes: Floats) -> Floats:
    """(n,) angles between body z and world z, rad. attitudes: (n, 4)."""
    up = quaternion.rotate(attitudes, np.broadcast_to([0.0, 0.0, 1.0], (len(attitudes), 3)))
    return np.asarray(np.arccos(np.clip(up[:, 2], -1.0, 1.0)))


def fly_whole(
    options: MockOptions,
    reference: Reference,
    *,
    plan: Plan | None = None,
    settings: FlyerSettings | None = None,
    controllers: Controllers | None = None,
    leave_after: float | None = None,
    limit: float = 120.0,
) -> WholeFlight:
    """Take off, track a reference and land.

    options: of the mock, its vehicle file among them.
    controllers: None for one of the vehicle file.
    leave_after: s in the air after which landing is requested; None to fly the reference to its end.
    limit: s after which the flight is given up.
    """
    vehicle = read_vehicle(options.vehicle)
    if controllers is None:
        controllers = Controllers(
            Controller.build(vehicle, ControllerOptions.for_vehicle(vehicle, period=CONTROL_PERIOD))
        )
    settings = settings or FlyerSettings(period=CONTROL_PERIOD, health=HealthLimits.for_vehicle(vehicle))
    autopilot = build_autopilot(options)
    curve = autopilot.parameters["THR_MDL_FAC"]
    flyer = build_flyer(controllers, reference, plan or Plan(origin="takeoff"), settings, thrust_curve=curve)
    return _Lockstep(autopilot, flyer, leave_after).fly(limit)


class _Lockstep:
    """The loop of ticks between one autopilot and one flyer."""

    def __init__(self, autopilot: Autopilot, flyer: Flyer, leave_after: float | None) -> None:
        assert isinstance(autopilot.vehicle, SimulatedVehicle)
        self._autopilot, self._flyer, self._leave_after = autopilot, flyer, leave_after
        self._vehicle = autopilot.vehicle
        self._flight = WholeFlight()
        self._estimate: StateEstimate | None = None
        self._monitor = EstimateMonitor()
        self._check: EstimateCheck | None = None
        self._tick = 0
        self._due = autopilot.time
        self._in_air_since = float("inf")
        self._was_armed = False

    def fly(self, limit: float) -> WholeFlight:
        """The flight until it is over or the limit, s."""
        self._advance(WAITING)
        while self._autopilot.time < limit:
            self._next_estimate()
            decision = self._decide()
            self._act(decision)
            if self._flyer.over and not self._autopilot.commander.armed:
                break
        self._flight.landed = self._flyer.landed and not self._autopilot.commander.armed
        self._flight.outcome = self._flyer.engagement.refusal or f"not over after {limit:g} s"
        return self._flight

    def _advance(self, duration: float) -> None:
        self._autopilot.advance(duration)
        self._due = self._autopilot.time

    def _next_estimate(self) -> None:
        """Advance to the step in which PX4 sends the next estimate of a stream of the control rate."""
        self._due += CONTROL_PERIOD
        while self._autopilot.time < self._due - TOLERANCE:
            self._autopilot.step()
            self._note_arming()
        if not self._autopilot.estimate_fault.stopped:
            self._receive()

    def _receive(self) -> None:
        """Take the estimate as from an ODOMETRY message."""
        now = round(1000 * self._autopilot.time) / 1000
        snapshot = self._autopilot.snapshot(self._autopilot.time)
        motion, taken = snapshot.motion, round(1000 * self._vehicle.estimate.time) / 1000
        wire = (*motion.position, *motion.attitude, *motion.velocity, *motion.rate)
        odometry = Odometry(taken, wire, LOCAL_NED, LOCAL_NED, snapshot.reset_counter)
        check = self._monitor.handle_odometry(odometry, taken, now, True)
        self._check = check if check.event or check.step is not None else self._check
        self._estimate = check.estimate or self._estimate

    def _note_arming(self) -> None:
        armed = self._autopilot.commander.armed
        if self._was_armed and not armed:
            self._flight.disarmed = self._autopilot.time
        self._was_armed = armed

    def _decide(self) -> Decision:
        commander = self._autopilot.commander
        now = round(1000 * self._autopilot.time) / 1000
        check, self._check = self._check, None
        step = check.step if check is not None and check.step is not None else NO_STEP
        name = (check.event or "") if check is not None else ""
        findings = {LINK_EVENTS[name]: check.text} if check is not None and name in LINK_EVENTS else {}
        if not commander.landed:
            self._in_air_since = min(self._in_air_since, now)
        leaves = self._leave_after is not None and now - self._in_air_since > self._leave_after
        force = self._vehicle.imu.specific_force_body
        observation = ObservationRecord(
            tick=self._tick,
            time=now,
            estimate_arrival=self._estimate.received if self._estimate else float("nan"),
            connected=True,
            armed=commander.armed,
            offboard=commander.mode is Mode.OFFBOARD,
            mode=commander.mode.name,
            landed=commander.landed,
            findings=msgspec.json.encode(findings).decode() if findings else "",
            reset=step is not NO_STEP,
            reset_position=step.position_world,
            reset_yaw=step.yaw,
            specific_force_z=float(force[2]),
            specific_force_xy=force[:2],
            engage=self._tick == 0,
            leave="requested" if leaves else "",
        )
        decision = self._flyer.step(observation, self._estimate)
        self._flyer.prepare(now)
        self._keep(now, decision)
        self._tick += 1
        return decision

    def _keep(self, now: float, decision: Decision) -> None:
        flight, reference = self._flight, self._flyer.reference_now(now)
        flight.time.append(now)
        flight.truth.append(_state_of(self._vehicle.truth))
        flight.estimate.append(np.full(13, np.nan) if self._estimate is None else self._estimate.state)
        flight.reference.append(np.full(3, np.nan) if reference is None else reference[POSITION].copy())
        flight.phases.append(self._flyer.mission.phase)
        flight.ground_force.append(self._vehicle.ground_force)
        flight.clearance.append(self._vehicle.clearance)
        flight.events += [change.event.value for change in decision.event_changes if change.active]

    def _act(self, decision: Decision) -> None:
        autopilot = self._autopilot
        for request in decision.requests:
            accepted = autopilot.request(request.value)
            self._flight.refused += request is AutopilotRequest.DISARM and not accepted
            self._note_arming()
        if decision.rate_body is not None:
            setpoint = ControlSetpoint("rates", rate_body=decision.rate_body.copy(), thrust=decision.thrust)
            autopilot.commander.offboard.feed(autopilot.time + LATENCY, setpoint)


def _state_of(motion: MotionState) -> Floats:
    return np.concatenate([motion.position_world, motion.velocity_world, motion.attitude, motion.rate_body])
