"""Whole flights in lockstep: the runtime's flight logic and the mock's autopilot in one process, ground to ground.

As over a link, but without one: the autopilot's rules decide on arming, mode and disarming, estimates come when PX4
sends them (every second or third of its steps of 4 ms), with the estimator's errors and faults. Same inputs, same bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.controller_settings import CONTROL_PERIOD
from dynamics.references import Reference
from dynamics.state import ATTITUDE, POSITION
from dynamics.vehicle_file import read_vehicle
from runtime.control.controller import Controller, ControllerOptions
from runtime.flight.composition import Controllers, build_flyer
from runtime.flight.decision import Decision, FlyerSettings
from runtime.flight.engagement import AutopilotRequest
from runtime.flight.events import Event
from runtime.flight.flyer import Flyer
from runtime.flight.health import HealthLimits, estimator_health
from runtime.flight.last_setpoint import LOSS_TIME
from runtime.flight.mission import Plan
from runtime.flight.phases import Phase
from runtime.flight.thrust import rotor_speed
from runtime.link.estimate import EstimateCheck, EstimateMonitor, ResetStep, StateEstimate
from runtime.link.odometry import Odometry
from runtime.link.rotors import RotorReader, RotorReading, motor_of_rotors
from runtime.link.setpoint_echo import SetpointEcho, SetpointReport
from runtime.link.telemetry import EstimatorSample, MotorOutputs, RotorSpeeds, decode_telemetry
from runtime.record.records import ObservationRecord
from runtime.telemetry_buffer import LINK_EVENTS
from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.autopilot.modes import Mode
from sitl_mock.mock import MockOptions, build_autopilot
from sitl_mock.vehicle.tuning import rate_gains
from sitl_mock.vehicle.vehicle import SimulatedVehicle
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, MotionState
from sitl_mock.wire.motion_messages import LOCAL_NED
from sitl_mock.wire.snapshot import Snapshot
from sitl_mock.wire.status_messages import esc_status, estimator_status, servo_output_raw
from sitl_mock.wire.streams import TOLERANCE

LATENCY = 0.003  # s from an estimate to the setpoint's arrival
REPORT_PERIOD = 0.05  # s between two ATTITUDE_TARGET
ESTIMATOR_PERIOD = 0.5  # s between two ESTIMATOR_STATUS
WAITING = 3.0  # s that the vehicle stands before it is engaged
ALOFT = (Phase.APPROACH, Phase.TRACK, Phase.BRAKE, Phase.RETURN)
RotorMessage = Literal["", "ESC_STATUS", "SERVO_OUTPUT_RAW"]
NO_STEP = ResetStep(np.zeros(3), np.zeros(3), 0.0)
CARRIED = 0.05  # of the weight, from which on the ground counts as touched


@dataclass
class WholeFlight:
    """A flight from the ground to the ground, tick by tick, and what was true in it. Times are simulated, s.

    landed: whether the flight ended by the runtime's own landing.
    outcome: why it ended.
    landing_reason: why it was cut short, empty when it was not.
    time: (ticks,) of each tick.
    truth, estimate: (ticks, 13) rigid-body states.
    reference: (ticks, 3) position of the reference in the estimator's frame, m; NaN where none is tracked.
    phases: (ticks,) of the mission.
    thrust: (ticks,) collective thrust sent, N; 0 where nothing is sent.
    setpoints_sent: (ticks,) whether a setpoint was sent.
    armed: (ticks,) whether the motors may turn.
    ground_force: (ticks,) share of the weight that the ground carries.
    clearance: (ticks,) distance of the feet from the ground, m.
    events: (time, event, detail) of each that was raised.
    refused: requests to disarm that the autopilot refused.
    disarmed: when the motors stopped for good; NaN if they did not.
    """

    landed: bool = False
    outcome: str = ""
    landing_reason: str = ""
    time: list[float] = field(default_factory=list)
    truth: list[Floats] = field(default_factory=list)
    estimate: list[Floats] = field(default_factory=list)
    reference: list[Floats] = field(default_factory=list)
    phases: list[Phase] = field(default_factory=list)
    thrust: list[float] = field(default_factory=list)
    setpoints_sent: list[bool] = field(default_factory=list)
    armed: list[bool] = field(default_factory=list)
    ground_force: list[float] = field(default_factory=list)
    clearance: list[float] = field(default_factory=list)
    events: list[tuple[float, Event, str]] = field(default_factory=list)
    refused: int = 0
    disarmed: float = float("nan")

    @property
    def raised(self) -> set[Event]:
        """The events that were raised."""
        return {event for _, event, _ in self.events}

    def times(self, event: Event) -> list[float]:
        """When an event was raised, s."""
        return [time for time, raised, _ in self.events if raised is event]

    @property
    def contact(self) -> int:
        """The tick of the last contact with the ground; the number of ticks if it never flew or landed."""
        columns = zip(self.ground_force, self.armed, self.clearance, strict=True)
        flying = np.flatnonzero([force < CARRIED and armed and height > 0.0 for force, armed, height in columns])
        return int(flying[-1]) + 1 if flying.size else len(self.time)

    @property
    def aloft(self) -> list[int]:
        """The ticks between take-off and landing."""
        return [tick for tick, phase in enumerate(self.phases) if phase in ALOFT]

    @property
    def touched(self) -> float:
        """When the ground first carried a part of the weight between take-off and landing, s; NaN if it never did.

        The tick that ends the flight counts, too: a crash may be noticed in the tick of the contact.
        """
        ticks = self.aloft
        ticks += [tick + 1 for tick in ticks[-1:] if tick + 1 < len(self.time)]
        return next((self.time[tick] for tick in ticks if self.ground_force[tick] > CARRIED), float("nan"))

    @property
    def tilt(self) -> Floats:
        """(ticks,) true tilt, rad."""
        return tilts(np.array(self.truth)[:, ATTITUDE])

    @property
    def tilt_after_contact(self) -> float:
        """Greatest true tilt from the last contact on, rad; NaN without one."""
        return float(self.tilt[self.contact :].max(initial=-1.0)) if self.contact < len(self.time) else float("nan")

    def tracking_error(self, states: Sequence[Floats]) -> float:
        """RMS distance of `truth` or `estimate` from the reference while it is tracked, m; NaN if it never was."""
        away = self.distances(states)
        return float(np.sqrt(np.nanmean(away**2))) if away.size else float("nan")

    def distances(self, states: Sequence[Floats]) -> Floats:
        """(m,) distance of `truth` or `estimate` from the reference at every tick that tracks it, m."""
        ticks = [tick for tick, phase in enumerate(self.phases) if phase is Phase.TRACK]
        return np.array([np.linalg.norm(states[tick][POSITION] - self.reference[tick]) for tick in ticks])


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
    watch: Callable[[Lockstep], None] | None = None,
    limit: float = 120.0,
    rotors: RotorMessage = "",
) -> WholeFlight:
    """Take off, track a reference and land.

    options: of the mock, its vehicle file among them.
    controllers: None for one of the vehicle file.
    leave_after: s in the air after which landing is requested; None to fly the reference to its end.
    watch: called before each tick, to plant a fault.
    limit: s after which the flight is given up.
    rotors: message by which the autopilot sends what its rotors do, with every estimate; none by default.
    """
    vehicle = read_vehicle(options.vehicle, effect_files=options.effect_files)
    settings = settings or FlyerSettings(period=CONTROL_PERIOD, health=HealthLimits.for_vehicle(vehicle))
    autopilot = build_autopilot(options)
    if controllers is None:
        gains = rate_gains(autopilot.parameters.tuning())
        choice = ControllerOptions.for_vehicle(vehicle, period=CONTROL_PERIOD, gains=gains)
        controllers = Controllers(Controller.build(vehicle, choice))
    curve = autopilot.parameters["THR_MDL_FAC"]
    loss_time = autopilot.parameters[LOSS_TIME]
    plan = plan or Plan(origin="takeoff")
    flyer = build_flyer(controllers, reference, plan, settings, thrust_curve=curve, loss_time=loss_time)
    return Lockstep(autopilot, flyer, leave_after, rotors).fly(limit, watch)


class Lockstep:
    """The loop of ticks between one autopilot and one flyer.

    autopilot, vehicle, flyer: of the flight, for those who watch it.
    stall: s for which this computer misses all ticks from the next one on.
    jitter: s by which the link may delay each message, in both directions, in order.
    """

    def __init__(
        self, autopilot: Autopilot, flyer: Flyer, leave_after: float | None = None, rotors: RotorMessage = ""
    ) -> None:
        """leave_after, rotors: as in `fly_whole`."""
        assert isinstance(autopilot.vehicle, SimulatedVehicle)
        self.autopilot, self.flyer, self._leave_after = autopilot, flyer, leave_after
        self.vehicle = autopilot.vehicle
        self._flight = WholeFlight()
        self._estimate: StateEstimate | None = None
        self._monitor = EstimateMonitor()
        self._check: EstimateCheck | None = None
        self._rotor_message = rotors
        self._rotor_reader: RotorReader | None = None
        self._reading: RotorReading | None = None
        if rotors:
            geometry = self.vehicle.vehicle.rotors
            flyer.motors = order = motor_of_rotors(geometry)
            assert order is not None
            self._rotor_reader = RotorReader(order, partial(rotor_speed, rotors=geometry))
        self._estimator_findings: dict[Event, str] = {}
        self._estimator_due = 0.0
        self.stall = 0.0
        self.jitter = 0.0
        self._random = np.random.default_rng(0)
        self._wire: deque[tuple[float, Odometry]] = deque()
        self._arrival = self._setpoint_arrival = 0.0
        self._echo = SetpointEcho()
        self._reported = 0.0
        self._tick = 0
        self._due = autopilot.time
        self._in_air_since = float("inf")
        self._was_armed = False

    def fly(self, limit: float, watch: Callable[[Lockstep], None] | None = None) -> WholeFlight:
        """The flight until it is over or the limit, s. watch: called before each tick."""
        self._advance(WAITING)
        while self.autopilot.time < limit:
            if watch is not None:
                watch(self)
            self._next_estimate()
            decision = self._decide()
            self._act(decision)
            if self.flyer.over and not self.autopilot.commander.armed:
                break
        self._flight.landed = self.flyer.landed and not self.autopilot.commander.armed
        self._flight.outcome = self.flyer.engagement.refusal or f"not over after {limit:g} s"
        self._flight.landing_reason = self.flyer.mission.landing_reason
        return self._flight

    def _advance(self, duration: float) -> None:
        self.autopilot.advance(duration)
        self._due = self.autopilot.time

    def _next_estimate(self) -> None:
        """Advance to the step in which PX4 sends the next estimate of a stream of the control rate."""
        self._due += max(CONTROL_PERIOD, self.stall)
        stalled, self.stall = self.stall, 0.0
        while self.autopilot.time < self._due - TOLERANCE:
            self.autopilot.step()
            self._note_arming()
        if stalled:
            self._due = self.autopilot.time
        if not self.autopilot.estimate_fault.stopped:
            self._receive()

    def _receive(self) -> None:
        """Take the estimate as from an ODOMETRY message."""
        now = round(1000 * self.autopilot.time) / 1000
        snapshot = self.autopilot.snapshot(self.autopilot.time)
        motion, taken = snapshot.motion, round(1000 * self.vehicle.estimate.time) / 1000
        wire = (*motion.position, *motion.attitude, *motion.velocity, *motion.rate)
        odometry = Odometry(taken, wire, LOCAL_NED, LOCAL_NED, snapshot.reset_counter)
        self._arrival = max(self._arrival, now + self._delay())
        self._wire.append((self._arrival, odometry))
        while self._wire and self._wire[0][0] <= now:
            _, odometry = self._wire.popleft()
            self._take(odometry, now)
        self._report_setpoint(snapshot, now)
        self._report_estimator(snapshot, now)
        self._report_rotors(snapshot, now)

    def _delay(self) -> float:
        return float(self._random.uniform(0.0, self.jitter)) if self.jitter else 0.0

    def _report_setpoint(self, snapshot: Snapshot, now: float) -> None:
        """Take what the autopilot follows, as often as ATTITUDE_TARGET is requested."""
        if now - self._reported >= REPORT_PERIOD:
            self._reported = now
            roll, pitch, yaw = snapshot.setpoint.rate
            self._echo.report(SetpointReport(now, (roll, -pitch, -yaw), snapshot.setpoint.thrust))

    def _take(self, odometry: Odometry, now: float) -> None:
        check = self._monitor.handle_odometry(odometry, odometry.time, now, True)
        self._check = check if check.event or check.step is not None else self._check
        self._estimate = check.estimate or self._estimate

    def _report_estimator(self, snapshot: Snapshot, now: float) -> None:
        """Take what the estimator reports of itself, as often as ESTIMATOR_STATUS comes."""
        if now < self._estimator_due:
            return
        self._estimator_due = now + ESTIMATOR_PERIOD
        status = decode_telemetry(estimator_status(snapshot), now, lambda time, _: time)
        assert isinstance(status, EstimatorSample)
        self._estimator_findings = estimator_health(status)

    def _report_rotors(self, snapshot: Snapshot, now: float) -> None:
        """Take what the autopilot sends of its rotors."""
        if self._rotor_reader is None:
            return
        messages = esc_status(snapshot) if self._rotor_message == "ESC_STATUS" else [servo_output_raw(snapshot)]
        for message in messages:
            sample = decode_telemetry(message, now, lambda _, received: received)
            assert isinstance(sample, RotorSpeeds | MotorOutputs)
            self._reading = self._rotor_reader.read(sample) or self._reading

    def _note_arming(self) -> None:
        armed = self.autopilot.commander.armed
        if self._was_armed and not armed:
            self._flight.disarmed = self.autopilot.time
        self._was_armed = armed

    def _decide(self) -> Decision:
        commander = self.autopilot.commander
        now = round(1000 * self.autopilot.time) / 1000
        check, self._check = self._check, None
        step = check.step if check is not None and check.step is not None else NO_STEP
        name = (check.event or "") if check is not None else ""
        findings = {LINK_EVENTS[name]: check.text} if check is not None and name in LINK_EVENTS else {}
        findings |= self._estimator_findings
        judged = commander.armed and commander.mode is Mode.OFFBOARD and self.flyer.engagement.flying
        if other := self._echo.finding(now, judged=judged):
            findings[Event.OTHER_CONTROLLER] = other
        if not commander.landed:
            self._in_air_since = min(self._in_air_since, now)
        leaves = self._leave_after is not None and now - self._in_air_since > self._leave_after
        force = self.vehicle.imu.specific_force_body
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
            **self._rotor_fields(),
        )
        decision = self.flyer.step(observation, self._estimate)
        self.flyer.prepare(now)
        self._keep(now, decision)
        self._tick += 1
        return decision

    def _rotor_fields(self) -> dict[str, Any]:
        reading, self._reading = self._reading, None
        if reading is None:
            return {}
        return {"rotor_time": reading.time, "rotor_speed": reading.speed, "rotors_measured": reading.measured}

    def _keep(self, now: float, decision: Decision) -> None:
        flight, reference = self._flight, self.flyer.reference_now(now)
        flight.time.append(now)
        flight.truth.append(_state_of(self.vehicle.truth))
        flight.estimate.append(np.full(13, np.nan) if self._estimate is None else self._estimate.state)
        flight.reference.append(np.full(3, np.nan) if reference is None else reference[POSITION].copy())
        flight.phases.append(self.flyer.mission.phase)
        flight.ground_force.append(self.vehicle.ground_force)
        flight.clearance.append(self.vehicle.clearance)
        flight.thrust.append(decision.collective_thrust if decision.rate_body is not None else 0.0)
        flight.setpoints_sent.append(decision.rate_body is not None)
        flight.armed.append(self.autopilot.commander.armed)
        raised = [change for change in decision.event_changes if change.active]
        flight.events += [(change.time, change.event, change.detail) for change in raised]

    def _act(self, decision: Decision) -> None:
        autopilot = self.autopilot
        for request in decision.requests:
            accepted = autopilot.request(request.value)
            self._flight.refused += request is AutopilotRequest.DISARM and not accepted
            self._note_arming()
        if decision.rate_body is not None:
            setpoint = ControlSetpoint("rates", rate_body=decision.rate_body.copy(), thrust=decision.thrust)
            self._setpoint_arrival = max(self._setpoint_arrival, autopilot.time + LATENCY + self._delay())
            autopilot.commander.offboard.feed(self._setpoint_arrival, setpoint)
            x, y, z = decision.rate_body.tolist()
            self._echo.sent(round(1000 * autopilot.time) / 1000, (x, y, z), decision.thrust)


def _state_of(motion: MotionState) -> Floats:
    return np.concatenate([motion.position_world, motion.velocity_world, motion.attitude, motion.rate_body])
