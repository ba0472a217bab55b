"""The daemon: one flight's link, control thread, request worker, recorder, and supervisor.

The supervisor runs in the caller's thread and does whatever may take long: it requests rates, runs the slow
checks, publishes notifications, and turns signals into a landing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from math import isnan
from pathlib import Path

import msgspec

from dynamics.errors import RequestError, VehicleError
from dynamics.vehicle import Vehicle
from runtime import realtime
from runtime.autopilot_parameters import read_thrust_curve
from runtime.control.bundle import Bundle
from runtime.control.controller import ControllerOptions
from runtime.control_thread import ControlThread, Notification, Requests
from runtime.flight.composition import (
    Controllers,
    build_controllers,
    build_flyer,
    vehicle_facts,
    warm_up,
)
from runtime.flight.engagement import State, Transition
from runtime.flight.events import POLICIES, Event, EventChange, Severity
from runtime.flight.motion import Motion
from runtime.flight.start_check import start_refusal
from runtime.flight.thrust import rotor_speed
from runtime.flight_request import FlightReport, FlightRequest
from runtime.link.commands import request_rates
from runtime.link.link import Link, LinkSettings
from runtime.link.rotors import RotorReader, motor_of_rotors, motor_positions
from runtime.link.start_conditions import STREAMS as START_STREAMS
from runtime.link.start_conditions import observe_start, start_problems
from runtime.link.telemetry import VehicleStatus
from runtime.preparation import SLOW_STREAMS, estimates_keep_up, required_rates, slow_findings, use_rate_gains
from runtime.record.recorder import Recorder
from runtime.record.records import EventRecord
from runtime.request_worker import RequestWorker, link_handlers
from runtime.rotor_loss_note import leave_note, require_no_note
from runtime.service_manager import ServiceManager
from runtime.stream_requests import StreamRequests
from runtime.stream_watch import StreamWatch
from runtime.telemetry_buffer import TelemetryBuffer

BACKGROUND_PRIORITY = 1  # of SCHED_FIFO, for recorder and supervisor
SUPERVISION_PERIOD = 0.1  # s
SETTLING_TIME = 1.5  # s, at most, in which clock and streams settle before their state is reported
READINESS_PATIENCE = 10.0  # s until no check may refuse engaging any more
MODE_DELAY = 1.5  # s by which HEARTBEAT, at 1 Hz, may show a mode late
STOP_PATIENCE = 1.0  # s until the link is closed under a control thread that does not end
REQUEST_PATIENCE = 2.5  # s in which the autopilot is to answer the last request, such as LAND
PILOT_REMINDER = 10.0  # s between the lines that say that the pilot is to arm
LANDING_PATIENCE = 60.0  # s from a request to land until streaming is stopped


Announce = Callable[[str], None]


class Daemon:
    """One flight, from finding the vehicle to leaving it."""

    def __init__(
        self,
        request: FlightRequest,
        vehicle: Vehicle,
        reference: Motion,
        announce: Announce,
        *,
        bundle: Bundle | None = None,
    ) -> None:
        """Prepare a flight; nothing is opened yet.

        announce: takes one line of text, which starts with the time since now, s; called from the thread that calls
            `fly`.
        bundle: of the learned model to fly, None for the vehicle file's model.
        """
        self._bundle = bundle
        self._request, self._vehicle, self._reference = request, vehicle, reference
        self._publish_line = announce
        self._created = time.monotonic()
        self._requests = Requests()
        self._landing_since = float("inf")
        self._engagement_requested = False
        self._recorder: Recorder | None = None
        self._telemetry = TelemetryBuffer()
        self._scheduling, self._refusals = realtime.Scheduling(None), 0
        self._service = ServiceManager()

    def _announce(self, text: str, at: float | None = None) -> None:
        """Publish a line. at: when it happened, s, monotonic; None for now."""
        with suppress(OSError, ValueError):  # a terminal or pipe that is closed ends no flight
            self._publish_line(f"{(at or time.monotonic()) - self._created:8.2f} s  {text}")

    def interrupt(self, name: str) -> None:
        """Land, and on a second call stop streaming at once. For signal handlers; name: the signal's.

        Raises KeyboardInterrupt before anything is requested of the vehicle.
        """
        if not self._engagement_requested:
            raise KeyboardInterrupt
        if self._requests.leave:
            self._requests.stop = True
        self._requests.leave = self._requests.leave or name

    def fly(self) -> FlightReport:
        """Find the vehicle, fly, land. Raises VehicleError when it cannot be reached or engaged."""
        request = self._request
        require_no_note(request.record, self._vehicle.name)
        with ExitStack() as stack:
            if request.record is not None:
                self._recorder = self._open_recorder(request.record)
                stack.callback(self._recorder.close)
            self._service = ServiceManager.from_environment()
            stack.callback(self._service.close)
            self._telemetry = TelemetryBuffer(self._recorder)
            self._scheduling = stack.enter_context(realtime.Scheduling(request.priority))
            settings = LinkSettings(
                target_system=request.system,
                roaming=request.roaming,
                signing_key=request.signing_key,
                priority=self._scheduling.priority,
            )
            link = stack.enter_context(Link(request.endpoint, settings, self._telemetry.callbacks))
            # while the link listens
            controllers = build_controllers(self._vehicle, self._bundle, self._controller_options())
            warm_up(controllers, self._reference, request.plan, rate=request.rate)
            status = link.wait_for_vehicle(request.timeout)
            self._check_autopilot(status)
            link.require_one_vehicle()
            link.signing.require_common(link.peer.address)
            control = self._prepare(link, controllers)
            stack.callback(self._stop, link, control)  # before the first setpoint: whatever fails from now on parts
            self._start(link, control)
            self._serve(link, control)
            return self._report(link, control)

    # --- before the flight

    def _open_recorder(self, folder: Path) -> Recorder:
        name = self._request.name or time.strftime("%Y%m%d-%H%M%S")
        try:
            metadata = self._request.recording_metadata(self._controller_options())
            return Recorder(
                folder,
                name,
                metadata=metadata,
                attachments=self._request.attachments,
                max_bytes=self._request.record_limit,
            )
        except OSError as error:
            raise RequestError(
                f"cannot record {name} in {folder}: {error.strerror}. Give --record a folder that can be written."
            ) from None

    def _check_autopilot(self, status: VehicleStatus) -> None:
        self._announce(f"vehicle {status.system}: {status.kind} with {status.autopilot}, mode {status.mode}")
        if status.autopilot != "px4":
            raise VehicleError(
                f"The autopilot is {status.autopilot}; only PX4's modes and OFFBOARD rules are supported. "
                "Nothing was sent."
            )

    def _controller_options(self) -> ControllerOptions:
        return self._request.controller_options(self._vehicle, self._bundle)

    def _prepare(self, link: Link, controllers: Controllers) -> ControlThread:
        """Check the start, and build what flies; nothing is sent to the vehicle but requests for streams."""
        request = self._request
        realtime.prepare_interpreter()
        scheduling = self._scheduling
        scheduling.raise_all(BACKGROUND_PRIORITY, exempt="link")
        self._report_refusals()
        self._rates = required_rates(request.rate)
        request_rates(link, self._rates)
        thrust_curve = read_thrust_curve(link, self._recorder, self._announce)
        options = self._controller_options()
        use_rate_gains(link, controllers, options, self._vehicle, self._recorder, self._announce)
        self._flyer = build_flyer(
            controllers, self._reference, request.plan, request.flyer_settings, thrust_curve=thrust_curve
        )
        if request.adaptation.mode != "off":
            self._read_rotors(link)
        self._check_start(link, controllers.flying.trim)
        self._requests.slow_findings = self._settle(link)
        return ControlThread(
            link,
            self._telemetry,
            self._flyer,
            self._requests,
            period=1.0 / request.rate,
            priority=scheduling.priority,
            processor=request.processor,
            recorder=self._recorder,
        )

    def _start(self, link: Link, control: ControlThread) -> None:
        """Start the control thread, and the worker that passes its requests on."""
        self._worker = RequestWorker(control.autopilot_requests, link_handlers(link), lambda: control.join(0.0))
        self._engagement_requested = True
        self._requests.engage = True
        control.start()
        self._worker.start()
        self._service.ready()
        self._streams = StreamRequests(partial(request_rates, link), {**self._rates, **SLOW_STREAMS})
        self._streams.send(time.monotonic())

    def _read_rotors(self, link: Link) -> None:
        """Let speeds of the rotors reach the flight, where it is clear which motor is which rotor."""
        rotors = self._vehicle.rotors
        self._flyer.motors = motor_of_rotors(rotors, motor_positions(link, rotors.count))
        if self._flyer.motors is None:
            self._announce("which motor is which rotor is not clear: a rotor that loses thrust is not named")
        else:
            self._telemetry.rotor_reader = RotorReader(self._flyer.motors, partial(rotor_speed, rotors=rotors))

    def _check_start(self, link: Link, trim: Vehicle) -> None:
        """Refuse a reference that leads from here into the ground or far away. trim: the vehicle as it hovers."""
        estimate = link.wait_for_estimate(None, time.monotonic() + self._request.timeout)
        if estimate is None:
            return  # the check of rates refuses engagement instead
        on_ground = not link.status.armed
        reason = start_refusal(
            self._reference,
            estimate.position_world,
            on_ground=on_ground,
            from_here=on_ground and self._request.plan.origin == "takeoff",
            box=self._vehicle.limits.box,
        )
        if reason:
            self._report_event(Event.REFERENCE_INFEASIBLE, reason)
            raise RequestError(reason)
        self._check_conditions(link, trim)

    def _check_conditions(self, link: Link, trim: Vehicle) -> None:
        """Refuse a vehicle that must not be armed as it stands; announce what should be understood before it flies."""
        request_rates(link, START_STREAMS)
        problems = start_problems(observe_start(link), vehicle_facts(trim))
        request_rates(link, dict.fromkeys(START_STREAMS, 0.0))
        for problem in problems:
            self._announce(problem.text if problem.severity == "error" else f"warning: {problem.text}")
        refusals = [problem.text for problem in problems if problem.severity == "error"]
        if refusals:
            raise VehicleError(f"The vehicle is not armed: {' '.join(refusals)}")

    def _settle(self, link: Link) -> dict[Event, str]:
        """Wait a moment for the clock and the requested streams. Returns what is still missing."""
        deadline = time.monotonic() + SETTLING_TIME
        while (present := self._slow_findings(link, time.monotonic())) and time.monotonic() < deadline:
            time.sleep(0.02)
        return present

    def _report_refusals(self) -> None:
        """Announce and record what was refused of real-time scheduling since the last call."""
        new = self._scheduling.refusals[self._refusals :]
        self._refusals += len(new)
        for refusal in new:
            self._report_event(Event.REALTIME_UNAVAILABLE, refusal)

    def _report_event(self, event: Event, detail: str) -> None:
        """Announce and record an event that no tick raises."""
        now, policy = time.monotonic(), POLICIES[event]
        text = f"{policy.text}: {detail}"
        self._announce(text)
        if self._recorder is not None:
            self._recorder.put(EventRecord(now, event.value, True, int(policy.severity), text), now)

    # --- during the flight

    def _serve(self, link: Link, control: ControlThread) -> None:
        """Supervise until the control thread is done."""
        watch = StreamWatch(control, link)
        self._heard_since, self._reminded = time.monotonic(), -float("inf")
        while not control.join(SUPERVISION_PERIOD):
            now = time.monotonic()
            self._service.progress(control.ticks)
            if standstill := watch.check(now):
                self._announce(standstill)
            self._requests.slow_findings = self._slow_findings(link, now)
            self._report_refusals()
            self._publish(link, control)
            self._await_readiness(link, now)
            self._remind_pilot(link, now)
            if self._requests.leave:
                self._landing_since = min(self._landing_since, now)
            if now - self._landing_since > LANDING_PATIENCE:
                self._announce(f"not landed within {LANDING_PATIENCE:g} s, LAND is requested")
                self._requests.stop = True
        self._service.stopping()  # before the last request is answered, which may take longer than a watchdog waits
        self._worker.join(REQUEST_PATIENCE)
        self._publish(link, control)

    def _await_readiness(self, link: Link, now: float) -> None:
        """Ask for slow streams again, and give up waiting for a vehicle that is silent or not ready for too long."""
        connected = link.is_connected(now)
        if not connected:
            self._heard_since = now
        elif Event.RATES_LOW in self._requests.slow_findings:
            self._streams.repeat(now)
        engagement = self._flyer.engagement
        if engagement.state not in (State.DISCONNECTED, State.STANDBY) or not engagement.requested:
            return
        silence = now - link.status.last_heard
        if connected and now - self._heard_since > READINESS_PATIENCE:
            reason = engagement.refusal or "no estimate came"
        elif not connected and silence > self._request.timeout:
            reason = f"the vehicle has been silent for {silence:.0f} s"
        else:
            return
        self._requests.leave = self._requests.leave or f"not engaged: {reason}"

    def _remind_pilot(self, link: Link, now: float) -> None:
        """Tell the pilot at the start of the wait, and again and again, that arming starts the flight."""
        if not self._flyer.engagement.awaits_pilot:
            self._reminded = -float("inf")
        elif now - self._reminded >= PILOT_REMINDER:
            self._reminded = now
            self._announce("waiting for the pilot to arm: the vehicle takes off at once")
            link.send_text("alula: waits for arming, takes off at once", Severity.NOTICE)
        if self._flyer.engagement.awaits_pilot:
            self._heard_since = now  # what hinders from now on has the whole of its time to pass

    def _slow_findings(self, link: Link, now: float) -> dict[Event, str]:
        rate = self._request.rate
        self._requests.estimates_keep_up = estimates_keep_up(self._telemetry, rate=rate, now=now)
        return slow_findings(link, self._telemetry, self._recorder, rate=rate, now=now)

    def _publish(self, link: Link, control: ControlThread) -> None:
        while self._telemetry.notifications:
            event = self._telemetry.notifications.popleft()
            self._announce(f"link: {event.text}", event.time)
        while self._telemetry.texts:
            self._announce(f"vehicle: {self._telemetry.texts.popleft()}")
        while not control.notifications.empty():
            self._publish_notification(link, control.notifications.get())

    def _publish_notification(self, link: Link, notification: Notification) -> None:
        match notification:
            case Transition():
                refusal = f" ({self._worker.refusal})" if self._worker.refusal else ""
                self._announce(f"{notification}{refusal}", notification.time)
                self._service.status(f"{notification}{refusal}")
                link.send_text(f"alula: {notification.after.value}: {notification.reason}", Severity.NOTICE)
            case EventChange():
                policy = POLICIES[notification.event]
                word = "" if notification.active else "over: "
                self._announce(f"{word}{notification.text}", notification.time)
                if notification.active and policy.severity <= Severity.NOTICE:
                    link.send_text(f"alula: {notification.text}", policy.severity)
            case str():
                self._announce(notification)
                link.send_text(f"alula: {notification}", Severity.WARNING)

    # --- after the flight

    def _stop(self, link: Link, control: ControlThread) -> None:
        """End the control thread: no setpoint leaves after this, whatever ended the flight, but those it may hold."""
        self._requests.stop = True
        if control.join(STOP_PATIENCE):
            self._service.stopping()
            self._worker.join(REQUEST_PATIENCE)
        else:
            StreamWatch(control, link).end_stream()
            link.close()
            self._announce(f"the control thread did not end within {STOP_PATIENCE:g} s: its link was closed")
            self._service.stopping()

    def _left_behind(self, status: VehicleStatus) -> str:
        """Suffix: state of a vehicle left armed, in brackets; empty for a disarmed one."""
        silence = time.monotonic() - status.last_heard
        if silence > LinkSettings().silence:
            state = f"{'armed' if status.armed else 'disarmed'} in {status.mode}"
            return (
                f" (the vehicle has been silent for {silence:.1f} s, and was {state} before: its own failsafe has it, "
                "if its autopilot still runs)"
            )
        return f" (the vehicle is armed, mode {status.mode}: the autopilot or the pilot has it)" if status.armed else ""

    def _report(self, link: Link, control: ControlThread) -> FlightReport:
        flyer, status = self._flyer, link.status
        outcome = flyer.engagement.refusal or "stopped streaming at once"
        if self._worker.refusal and not flyer.landed:
            outcome = f"{outcome}: {self._worker.refusal}"
        if control.defect:
            outcome = f"{outcome}; a defect of the daemon: {control.defect}"
        outcome += self._left_behind(status)
        if loss := flyer.events.active.get(Event.ROTOR_FAILING):
            folder, text = None, loss
            if self._recorder is not None:
                folder, text = self._recorder.path.parent, f"{loss} ({self._recorder.path.name})"
            self._announce(leave_note(folder, self._vehicle.name, text))
        landed, cut_short = flyer.landed and not status.armed, flyer.mission.landing_reason
        start_up, origin = control.first_setpoint - self._created, flyer.mission.origin
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
            effectiveness=flyer.effectiveness.value if flyer.landed else flyer.effectiveness.earlier(MODE_DELAY),
            start_up=-1.0 if isnan(start_up) else start_up,
            scheduling=self._scheduling.describe(),
            origin=(float(origin[0]), float(origin[1]), float(origin[2])),
            followed=None
            if flyer.controllers.adaptation is None
            else msgspec.structs.replace(flyer.controllers.adaptation.followed, parameters=flyer.controllers.followed),
        )
