"""A flight of `alula fly` in simulated time: the runtime's link, control loop and recorder on the mock's autopilot.

The daemon's threads follow the clock, so that a host which withholds the processor ends a flight. Here the simulation
waits for the computing: MAVLink's bytes, the flight logic, each tick and the recording are the daemon's own, and the
flight is the same on every machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from math import isnan

from dynamics.errors import RequestError, VehicleError
from runtime.autopilot_parameters import read_loss_time, read_thrust_curve
from runtime.control_thread import ControlThread, Requests
from runtime.flight.composition import build_controllers, build_flyer
from runtime.flight.engagement import AutopilotRequest, State, Transition
from runtime.flight.events import EventChange
from runtime.flight.flyer import Flyer
from runtime.flight.start_check import start_refusal
from runtime.flight_request import FlightReport
from runtime.flight_setup import PreparedFlight
from runtime.link.commands import arming_command, command_message, mode_command, request_rates, send_command
from runtime.link.dialect import MESSAGE_IDS, mavlink
from runtime.preparation import SLOW_STREAMS, estimates_keep_up, required_rates, slow_findings, use_rate_gains
from runtime.record.recorder import Recorder
from runtime.telemetry_buffer import TelemetryBuffer
from runtime.timing import Schedule
from simulation.lockstep_link import LockstepLink
from sitl_mock.mock import MockOptions, build_autopilot

EPOCH = 1.8e9  # unix time at which simulated flights begin, s: recordings hold no time of day
SETTLING_TIME = 2.0  # s in which clock and estimates settle before the vehicle is engaged
VEHICLE_PATIENCE = 10.0  # s until a heartbeat
READINESS_PATIENCE = 10.0  # s until no check may refuse engaging any more
SUPERVISION_PERIOD = 0.1  # s
FURTHER = 90.0  # s that a flight may take beside its reference
RING_CAPACITY = 1_000_000  # records and frames of less than a second
# streams that neither a flight nor the reader of its recording uses, two fifths of what PX4 sends by default
UNREAD = (
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "ALTITUDE",
    "VFR_HUD",
    "GPS_RAW_INT",
    "POSITION_TARGET_LOCAL_NED",
    "DISTANCE_SENSOR",
    "ESC_INFO",
)
COMMANDS: Mapping[AutopilotRequest, tuple[int, tuple[float, ...]]] = {
    AutopilotRequest.OFFBOARD: mode_command("OFFBOARD"),
    AutopilotRequest.LAND: mode_command("LAND"),
    AutopilotRequest.ARM: arming_command(True),
    AutopilotRequest.DISARM: arming_command(False),
}
Announce = Callable[[str], None]
Watch = Callable[["SimulatedFlight"], None]


def fly_in_simulated_time(flight: PreparedFlight, mock: MockOptions, announce: Announce) -> FlightReport:
    """Take off, track the reference and land, as `Daemon.fly`; announce takes one line of text.

    Raises VehicleError when the vehicle cannot be engaged, RequestError for what cannot be flown or recorded.
    """
    with ExitStack() as stack:
        recorder = _open_recorder(flight)
        if recorder is not None:
            stack.callback(recorder.close)
        return SimulatedFlight(flight, mock, announce, recorder).fly()


def _open_recorder(flight: PreparedFlight) -> Recorder | None:
    request = flight.request
    if request.record is None:
        return None
    options = request.controller_options(flight.vehicle, flight.bundle)
    try:
        return Recorder(
            request.record,
            request.name or time.strftime("%Y%m%d-%H%M%S"),
            metadata=request.recording_metadata(options),
            attachments=request.attachments,
            capacity=RING_CAPACITY,
            simulated_epoch=EPOCH,
        )
    except OSError as error:
        raise RequestError(
            f"cannot record in {request.record}: {error.strerror}. Give a folder that can be written."
        ) from None


class SimulatedFlight:
    """A flight of the daemon's parts, tick by tick.

    autopilot, link, flyer, control: the parts, for those who watch; the last two from the first tick on.
    """

    flyer: Flyer
    control: ControlThread
    _schedule: Schedule

    def __init__(
        self,
        flight: PreparedFlight,
        mock: MockOptions,
        announce: Announce,
        recorder: Recorder | None = None,
        watch: Watch | None = None,
    ) -> None:
        """watch: called before each tick; it may let time pass on the link, as a computer that stands still does."""
        self._flight, self._recorder, self._publish_line, self._watch = flight, recorder, announce, watch
        self._telemetry = TelemetryBuffer(recorder)
        self.autopilot = build_autopilot(mock)
        self.link = LockstepLink(self.autopilot, self._telemetry.callbacks)
        self._began = self.link.now
        self._requests = Requests()
        self._supervised = -float("inf")

    def _announce(self, text: str) -> None:
        self._publish_line(f"{self.link.now - self._began:8.2f} s  {text}")

    def fly(self) -> FlightReport:
        """Fly to the end. Raises VehicleError when the vehicle cannot be engaged, RequestError for what cannot fly."""
        link, request = self.link, self._flight.request
        self.flyer = self._prepare()
        self.control = ControlThread(
            link,
            self._telemetry,
            self.flyer,
            self._requests,
            period=1.0 / request.rate,
            recorder=self._recorder,
            clock=link.clock,
        )
        self._requests.engage = True
        self._fly_ticks()
        self._publish(self.control)
        return self._report(self.flyer, self.control)

    def go_on(self, seconds: float) -> None:
        """Go on with the ticks of a flight that is over."""
        end = self.link.now + seconds
        while self.link.now < end:
            self._tick()

    def _prepare(self) -> Flyer:
        """Request streams, read the autopilot's parameters and build what flies."""
        link, flight = self.link, self._flight
        request, announce = flight.request, self._announce
        status = link.wait_for_vehicle(VEHICLE_PATIENCE)
        announce(f"vehicle {status.system}: {status.kind} with {status.autopilot}, mode {status.mode}, simulated")
        options = request.controller_options(flight.vehicle, flight.bundle)
        controllers = build_controllers(flight.vehicle, flight.bundle, options)
        request_rates(link, {**required_rates(request.rate), **SLOW_STREAMS})
        for name in UNREAD:
            send_command(link, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, MESSAGE_IDS[name], -1.0)
        curve = read_thrust_curve(link, self._recorder, announce, link.clock)
        loss_time = read_loss_time(link, self._recorder, announce, link.clock)
        use_rate_gains(link, controllers, options, flight.vehicle, self._recorder, announce, link.clock)
        link.advance(SETTLING_TIME)
        if link.estimate is None:
            raise VehicleError("the simulated vehicle sent no estimate.")
        refusal = start_refusal(
            flight.reference,
            link.estimate.position_world,
            on_ground=True,
            from_here=request.plan.origin == "takeoff",
            box=flight.vehicle.limits.box,
        )
        if refusal:
            raise RequestError(refusal)
        return build_flyer(
            controllers,
            flight.reference,
            request.plan,
            request.flyer_settings,
            thrust_curve=curve,
            loss_time=loss_time,
        )

    def _fly_ticks(self) -> None:
        """Ticks as the control thread's, each by an estimate or by the clock, until the flight is over."""
        link, request = self.link, self._flight.request
        start = link.now
        limit = start + FURTHER + self._flight.reference.duration
        self._schedule, self._estimate = Schedule(1.0 / request.rate, start=start), link.estimate
        while not self.flyer.over:
            self._supervise(self.flyer, self.control, start)
            self._tick()
            if link.now > limit:
                self._requests.stop = True
                self._announce(f"not over after {limit - start:.0f} s")
                break

    def _tick(self) -> None:
        link, schedule = self.link, self._schedule
        if self._watch is not None:
            self._watch(self)
        schedule.estimates_keep_up = self._requests.estimates_keep_up
        newest, latest = link.wait_for_estimate(self._estimate, schedule.latest), schedule.latest
        if newest is not None:
            self._estimate = newest
            if not schedule.is_due(newest.received):
                return
        by_clock = newest is None
        schedule.ticked(latest if newest is None else newest.received, link.now, by_clock=by_clock)
        self.control.tick(self._estimate, link.now, by_clock=by_clock)
        self._pass_on(self.control)

    def _pass_on(self, control: ControlThread) -> None:
        """Send the newest of the flight logic's requests as a command; the flight logic repeats what is still open."""
        newest = None
        while not control.autopilot_requests.empty():
            newest = control.autopilot_requests.get()
        if newest is not None:
            command, parameters = COMMANDS[newest]
            self.link.send(command_message(self.link, command, 0, *parameters))

    def _supervise(self, flyer: Flyer, control: ControlThread, start: float) -> None:
        link, now = self.link, self.link.now
        if now - self._supervised < SUPERVISION_PERIOD:
            return
        self._supervised, rate = now, self._flight.request.rate
        self._requests.slow_findings = slow_findings(link, self._telemetry, self._recorder, rate=rate, now=now)
        self._requests.estimates_keep_up = estimates_keep_up(self._telemetry, rate=rate, now=now)
        self._publish(control)
        waits = flyer.engagement.state in (State.DISCONNECTED, State.STANDBY) and flyer.engagement.requested
        if waits and now - start > READINESS_PATIENCE:
            reason = flyer.engagement.refusal or "no estimate came"
            self._requests.leave = self._requests.leave or f"not engaged: {reason}"

    def _publish(self, control: ControlThread) -> None:
        while self._telemetry.notifications:
            self._announce(f"link: {self._telemetry.notifications.popleft().text}")
        while self._telemetry.texts:
            self._announce(f"vehicle: {self._telemetry.texts.popleft()}")
        while not control.notifications.empty():
            notification = control.notifications.get()
            match notification:
                case EventChange():
                    self._announce(f"{'' if notification.active else 'over: '}{notification.text}")
                case Transition() | str():
                    self._announce(f"{notification}")

    def _report(self, flyer: Flyer, control: ControlThread) -> FlightReport:
        link, origin = self.link, flyer.mission.origin
        landed, cut_short = flyer.landed and not link.status.armed, flyer.mission.landing_reason
        return FlightReport(
            outcome=flyer.engagement.refusal or "stopped streaming at once",
            landed=landed,
            completed=landed and not cut_short,
            landing_reason=cut_short,
            recording=str(self._recorder.path) if self._recorder is not None else None,
            tracking=control.tracking.report(),
            timing=control.deadlines.report(),
            estimate_rate=self._telemetry.estimate_rate(link.now),
            events={event.value: count for event, count in flyer.events.counts.items() if count},
            effectiveness=flyer.effectiveness.value,
            start_up=-1.0 if isnan(control.first_setpoint) else control.first_setpoint - self._began,
            scheduling="simulated time",
            origin=(float(origin[0]), float(origin[1]), float(origin[2])),
        )
