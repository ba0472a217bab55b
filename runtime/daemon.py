"""The daemon: link, control thread, recorder and a supervisor that talks to the vehicle and to the user.

The supervisor, in the caller's thread, does all that may take its time: it asks for rates, modes and arming, judges
the slow things, publishes notifications, and turns SIGINT and SIGTERM into a landing.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from math import isnan
from pathlib import Path

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import RequestError, VehicleError
from dynamics.state import ATTITUDE, POSITION
from dynamics.vehicle import Vehicle
from runtime import realtime
from runtime.control.bundle import Bundle
from runtime.control.controller import Controller, ControllerOptions
from runtime.control_thread import ControlThread, Notification, Requests
from runtime.flight.engagement import AutopilotRequest, State, Transition
from runtime.flight.events import POLICIES, Event, EventChange, Severity
from runtime.flight.flyer import Flyer, FlyerSettings
from runtime.flight.mission import Mission, Motion, Plan
from runtime.flight.thrust import ThrustMap
from runtime.flight.tracking import TrackingReport
from runtime.link.commands import Confirmation, request_rates, set_armed, set_mode
from runtime.link.connection import Endpoint
from runtime.link.link import Link, LinkSettings
from runtime.link.parameters import read_parameter
from runtime.link.telemetry import VehicleStatus
from runtime.record.recorder import Recorder
from runtime.record.records import EventRecord, ParameterRecord
from runtime.telemetry_buffer import TelemetryBuffer
from runtime.timing import TimingReport

MIN_RATE = 0.9  # of the rate of estimates that the flight wants
MAX_ESTIMATE_RATE = 100.0  # Hz that a faster flight still needs no more of: PX4 gives 124 Hz on a request for 200
BACKGROUND_PRIORITY = 1  # of SCHED_FIFO, for recorder and supervisor
SUPERVISION_PERIOD = 0.1  # s
READINESS_PATIENCE = 10.0  # s until everything must speak for engaging
LEAVING_PATIENCE = 60.0  # s from an order to land until streaming is stopped
SLOW_STREAMS: Mapping[str, float] = {  # for the recording, and what may come late
    "EXTENDED_SYS_STATE": 5.0, "BATTERY_STATUS": 2.0, "ESC_STATUS": 100.0, "SERVO_OUTPUT_RAW": 100.0,
}  # fmt: skip
THRUST_CURVE = "THR_MDL_FAC"

WARM_UP_TICKS = 20
MAX_START = 50.0  # m from the vehicle to the start of the reference
MIN_CLEARANCE = 0.15  # m of the reference above where the vehicle stands
MAX_LOOK = 600.0  # s of the reference that are looked at before take-off

Announce = Callable[[str], None]


class FlightRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How to fly. rate: Hz. record: folder for recordings. system: the vehicle's system id, None for the first heard.

    timeout: s to wait for the vehicle. priority: of SCHED_FIFO, None for none. processor: to keep the control thread
    on. metadata and attachments go into the recording: the command, versions, seeds, hashes; the vehicle file.
    """

    endpoint: Endpoint
    rate: float = 100.0
    plan: Plan = Plan()
    settings: FlyerSettings = FlyerSettings()
    record: Path | None = None
    name: str = ""
    system: int | None = None
    timeout: float = 10.0
    priority: int | None = None
    processor: int | None = None
    metadata: Mapping[str, str] = {}
    attachments: Mapping[str, str] = {}


class FlightReport(msgspec.Struct, frozen=True):
    """What came of a flight. outcome: why it ended. landed: whether it ended on the ground, disarmed, by our doing.

    completed: landed, and not before it was meant to. landing_reason: why it was cut short, empty when it was not.
    start_up: s from making the daemon to the first setpoint, negative when none was sent.
    """

    outcome: str
    landed: bool
    completed: bool
    landing_reason: str
    recording: str | None
    tracking: TrackingReport
    timing: TimingReport
    estimate_rate: float
    events: dict[str, int]
    effectiveness: float
    start_up: float


class Daemon:
    """One flight, from finding the vehicle to leaving it."""

    def __init__(
        self, request: FlightRequest, vehicle: Vehicle, reference: Motion, announce: Announce, *,
        bundle: Bundle | None = None,
    ) -> None:  # fmt: skip
        """announce: takes one line of text, called from the thread that calls `fly`. bundle: of the model to fly."""
        self._bundle = bundle
        self._request, self._vehicle, self._reference = request, vehicle, reference
        self._announce = announce
        self._began = time.monotonic()
        self._requests = Requests()
        self._left_at = float("inf")
        self._engaging = False
        self._refusal = ""
        self._recorder: Recorder | None = None
        self._telemetry = TelemetryBuffer()

    def interrupt(self, name: str) -> None:
        """Land, told by a signal's name; told again, stop streaming at once. For signal handlers.

        Raises KeyboardInterrupt before anything is requested of the vehicle.
        """
        if not self._engaging:
            raise KeyboardInterrupt
        if self._requests.leave:
            self._requests.stop = True
        self._requests.leave = self._requests.leave or name

    def fly(self) -> FlightReport:
        """Find the vehicle, fly, land. Raises VehicleError when it cannot be reached or engaged."""
        request = self._request
        with ExitStack() as stack:
            if request.record is not None:
                self._recorder = self._open_recorder(request.record)
                stack.callback(self._recorder.close)
            self._telemetry = TelemetryBuffer(self._recorder)
            settings = LinkSettings(target_system=request.system, priority=request.priority)
            link = stack.enter_context(Link(request.endpoint, settings, self._telemetry.callbacks))
            controller, nominal = self._controllers()  # while the link listens
            for each in (controller, nominal):
                if each is not None:
                    self._warm_up(each)
            status = link.wait_for_vehicle(request.timeout)
            self._check_autopilot(status)
            stack.callback(realtime.lower_thread)
            control = self._start(link, controller, nominal)
            stack.callback(self._stop, control)
            self._serve(link, control)
            return self._report(link, control)

    # --- before the flight

    def _open_recorder(self, folder: Path) -> Recorder:
        name = self._request.name or time.strftime("%Y%m%d-%H%M%S")
        try:
            return Recorder(folder, name, metadata=self._metadata(), attachments=self._request.attachments)
        except OSError as error:
            raise RequestError(
                f"cannot record {name} in {folder}: {error.strerror}. Give --record a folder that can be written."
            ) from None

    def _check_autopilot(self, status: VehicleStatus) -> None:
        self._announce(f"vehicle {status.system}: {status.kind} with {status.autopilot}, mode {status.mode}")
        if status.autopilot != "px4":
            raise VehicleError(
                f"The autopilot is {status.autopilot}; only PX4's modes and OFFBOARD rules are known here. "
                "Nothing was sent."
            )

    def _controllers(self) -> tuple[Controller, Controller | None]:
        """The controller that flies, and beside a learned one that of the physical model."""
        options = self._controller_options()
        if self._bundle is None:
            return Controller.build(self._vehicle, options), None
        return Controller.of_bundle(self._bundle, options), Controller.beside(self._bundle, options)

    def _warm_up(self, controller: Controller) -> None:
        """Fly some ticks on paper: what a process does for the first time takes tens of milliseconds."""
        state = self._reference.states(np.zeros(1))[0]
        mission = Mission(controller.trim, self._reference, self._request.plan)
        mission.ramp(state, 0.0)
        mission.climb(state, 0.0)
        controller.reset(state, 0.0)
        for tick in range(WARM_UP_TICKS):
            now = tick / self._request.rate
            states, inputs = mission.window(controller.node_times(now), state[ATTITUDE])
            controller.prepare(states, inputs[:-1])
            controller.feedback(controller.compensate(state, now - 0.02, now), now)

    def _controller_options(self) -> ControllerOptions:
        return ControllerOptions(period=1.0 / self._request.rate)

    def _metadata(self) -> dict[str, str]:
        request = self._request
        settings = {
            "plan": msgspec.json.encode(request.plan).decode(),
            "settings": msgspec.json.encode(self._settings()).decode(),
            "controller": msgspec.json.encode(self._controller_options()).decode(),
            "endpoint": str(request.endpoint),
            "rate": repr(request.rate),
        }
        return {**settings, **request.metadata}

    def _settings(self) -> FlyerSettings:
        return msgspec.structs.replace(self._request.settings, period=1.0 / self._request.rate)

    def _start(self, link: Link, controller: Controller, nominal: Controller | None) -> ControlThread:
        request = self._request
        realtime.prepare_interpreter()
        if request.priority is not None:
            for refusal in (realtime.lock_memory(), realtime.raise_threads(BACKGROUND_PRIORITY, besides="link")):
                if refusal:
                    self._note(Event.REALTIME_UNAVAILABLE, refusal)
        rates = {"ODOMETRY": request.rate, "HIGHRES_IMU": min(request.rate, MAX_ESTIMATE_RATE)}
        request_rates(link, rates)
        thrust_map = self._thrust_map(link, controller.trim)
        mission = Mission(controller.trim, self._reference, request.plan)
        self._flyer = Flyer(controller.trim, controller, mission, thrust_map, self._settings(), nominal=nominal)
        self._check_start(link)
        self._requests.slow_findings = self._slow_findings(link, time.monotonic())
        control = ControlThread(
            link, self._telemetry, self._flyer, self._requests, period=1.0 / request.rate, priority=request.priority,
            processor=request.processor, recorder=self._recorder,
        )  # fmt: skip
        self._engaging = True
        self._requests.engage = True
        control.start()
        threading.Thread(target=request_rates, args=(link, SLOW_STREAMS), name="slow streams", daemon=True).start()
        return control

    def _thrust_map(self, link: Link, trim: Vehicle) -> ThrustMap:
        curve = read_parameter(link, THRUST_CURVE)
        if curve.value is None:
            self._announce(f"the vehicle does not tell {THRUST_CURVE} ({curve.error}); 0 is assumed")
        factor = float(curve.value or 0.0)
        if self._recorder is not None:
            now = time.monotonic()
            self._recorder.put(ParameterRecord(now, THRUST_CURVE, factor), now)
        return ThrustMap(trim.rotors.thrust_max, trim.rotors.thrust_curve, factor)

    def _check_start(self, link: Link) -> None:
        """Refuse a reference that leads from here into the ground or far away."""
        estimate = link.wait_for_estimate(None, time.monotonic() + self._request.timeout)
        if estimate is None:
            return  # the rates will say so, and refuse
        span = min(self._reference.duration, MAX_LOOK)
        path = self._reference.states(np.arange(0.0, span, 0.02))[:, POSITION]
        distance = float(np.linalg.norm(path[0] - estimate.position_world))
        if distance > MAX_START:
            raise self._infeasible(
                f"the reference starts {distance:.0f} m from the vehicle, which is at "
                f"{_place(estimate.position_world)} m (east, north, up). Begin nearer than {MAX_START:g} m."
            )
        ground, lowest = float(estimate.position_world[2]), float(np.min(path[:, 2]))
        if not link.status.armed and lowest < ground + MIN_CLEARANCE:
            raise self._infeasible(
                f"the reference comes down to {lowest:.2f} m, the vehicle stands at {ground:.2f} m. Keep "
                f"{MIN_CLEARANCE:g} m above it: give the manoeuvre a height, as in lemniscate:height=1."
            )

    def _infeasible(self, reason: str) -> RequestError:
        self._note(Event.REFERENCE_INFEASIBLE, reason)
        return RequestError(reason)

    def _note(self, event: Event, detail: str) -> None:
        """Tell and record an event that is found outside of the tick."""
        now, policy = time.monotonic(), POLICIES[event]
        text = f"{policy.text}: {detail}"
        self._announce(text)
        if self._recorder is not None:
            self._recorder.put(EventRecord(now, event.value, True, int(policy.severity), text), now)

    # --- during the flight

    def _serve(self, link: Link, control: ControlThread) -> None:
        """Supervise until the control thread is done."""
        worker = threading.Thread(target=self._forward_requests, args=(link, control), name="requests", daemon=True)
        worker.start()
        patience = time.monotonic() + READINESS_PATIENCE
        while not control.join(SUPERVISION_PERIOD):
            now = time.monotonic()
            self._requests.slow_findings = self._slow_findings(link, now)
            self._publish(link, control)
            engagement = self._flyer.engagement
            waiting = engagement.state in (State.DISCONNECTED, State.STANDBY) and engagement.requested
            if waiting and now > patience:
                reason = engagement.refusal or "no estimate came"
                self._requests.leave = self._requests.leave or f"not engaged: {reason}"
            if self._requests.leave:
                self._left_at = min(self._left_at, now)
            if now - self._left_at > LEAVING_PATIENCE:
                self._announce(f"not landed within {LEAVING_PATIENCE:g} s, the autopilot's failsafe acts")
                self._requests.stop = True
        self._publish(link, control)

    def _forward_requests(self, link: Link, control: ControlThread) -> None:
        """Pass the flight logic's requests on to the vehicle, one at a time, until the control thread is done."""
        ask: Mapping[AutopilotRequest, Callable[[], Confirmation]] = {
            AutopilotRequest.OFFBOARD: lambda: set_mode(link, "OFFBOARD", timeout=2.0),
            AutopilotRequest.ARM: lambda: set_armed(link, True, timeout=2.0),
            AutopilotRequest.DISARM: lambda: set_armed(link, False, timeout=2.0),
            AutopilotRequest.LAND: lambda: set_mode(link, "LAND", timeout=2.0),
        }
        while True:
            try:
                request = control.autopilot_requests.get(timeout=SUPERVISION_PERIOD)
            except queue.Empty:
                if control.join(0.0):
                    return
                continue
            while not control.autopilot_requests.empty():  # the newest counts
                request = control.autopilot_requests.get()
            answer = ask[request]()
            self._refusal = "" if answer.confirmed else answer.reason

    def _slow_findings(self, link: Link, now: float) -> dict[Event, str]:
        present: dict[Event, str] = {}
        rate, required = self._telemetry.estimate_rate(now), min(self._request.rate, MAX_ESTIMATE_RATE)
        self._requests.estimates_keep_up = rate >= MIN_RATE * self._request.rate
        if rate < MIN_RATE * required:
            present[Event.RATES_LOW] = f"estimates come at {rate:.0f} Hz, {required:.0f} Hz are wanted"
        if not link.peer.clock.is_valid(now):
            present[Event.CLOCK_UNCERTAIN] = f"TIMESYNC uncertain by {1e3 * link.peer.clock.uncertainty(now):.1f} ms"
        if self._recorder is not None and self._recorder.trouble:
            event = Event.RECORDER_OVERRUN if self._recorder.still_writing else Event.DISK_FULL
            present[event] = self._recorder.trouble
        return present

    def _publish(self, link: Link, control: ControlThread) -> None:
        while self._telemetry.notifications:
            event = self._telemetry.notifications.popleft()
            self._announce(f"link: {event.text}")
        while self._telemetry.texts:
            self._announce(f"vehicle: {self._telemetry.texts.popleft()}")
        while not control.notifications.empty():
            self._publish_notification(link, control.notifications.get())

    def _publish_notification(self, link: Link, notification: Notification) -> None:
        match notification:
            case Transition():
                self._announce(f"{notification}" + (f" ({self._refusal})" if self._refusal else ""))
                link.send_text(f"alula: {notification.after.value}: {notification.reason}", Severity.NOTICE)
            case EventChange():
                policy = POLICIES[notification.event]
                word = "" if notification.active else "over: "
                self._announce(f"{word}{notification.text}")
                if notification.active and policy.severity <= Severity.NOTICE:
                    link.send_text(f"alula: {notification.text}", policy.severity)
            case str():
                self._announce(notification)
                link.send_text(f"alula: {notification}", Severity.WARNING)

    # --- after the flight

    def _stop(self, control: ControlThread) -> None:
        """No setpoint leaves after this, whatever ended the flight."""
        self._requests.stop = True
        control.join(1.0)

    def _report(self, link: Link, control: ControlThread) -> FlightReport:
        flyer, status = self._flyer, link.status
        outcome = flyer.engagement.refusal or "stopped streaming at once"
        if self._refusal and not flyer.landed:
            outcome = f"{outcome}: {self._refusal}"
        if control.defect:
            outcome = f"{outcome}; a defect of ours: {control.defect}"
        if status.armed:
            outcome = f"{outcome} (the vehicle is armed, mode {status.mode}: the autopilot or the pilot has it)"
        landed, cut_short = flyer.landed and not status.armed, flyer.mission.landing_reason
        start_up = control.first_setpoint - self._began
        return FlightReport(
            outcome=outcome,
            landed=landed,
            completed=landed and cut_short in ("", self._requests.leave),
            landing_reason=cut_short,
            recording=str(self._recorder.path) if self._recorder is not None else None,
            tracking=control.tracking.report(),
            timing=control.deadlines.report(),
            estimate_rate=self._telemetry.estimate_rate(time.monotonic()),
            events={event.value: count for event, count in flyer.events.counts.items() if count},
            effectiveness=flyer.effectiveness.value,
            start_up=-1.0 if isnan(start_up) else start_up,
        )


def _place(position: Floats) -> str:
    return ", ".join(f"{value:.1f}" for value in position)
