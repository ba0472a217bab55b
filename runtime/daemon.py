"""The daemon: one flight's link, control thread, request worker, recorder and supervisor, started and ended.

The supervisor runs in the caller's thread and does whatever may take long: it requests rates, runs the slow
checks, publishes notifications, and turns signals into a landing.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from runtime import realtime
from runtime.announcements import Announce, Announcements, NotificationFeed
from runtime.autopilot_parameters import read_loss_time, read_thrust_curve
from runtime.control.bundle import Bundle
from runtime.control.controller import ControllerOptions
from runtime.control_thread import ControlThread, Requests
from runtime.flight.composition import Controllers, build_controllers, build_flyer, warm_up
from runtime.flight.events import Event
from runtime.flight.flyer import Flyer
from runtime.flight.motion import Motion
from runtime.flight.thrust import rotor_speed
from runtime.flight_outcome import flight_report
from runtime.flight_request import FlightReport, FlightRequest
from runtime.link.commands import request_rates
from runtime.link.link import Link, LinkSettings
from runtime.link.rotors import RotorReader, motor_of_rotors, motor_positions
from runtime.preparation import SLOW_STREAMS, estimates_keep_up, required_rates, slow_findings, use_rate_gains
from runtime.record.recorder import Recorder
from runtime.request_worker import RequestWorker, link_handlers
from runtime.rotor_loss_note import leave_note, require_no_note
from runtime.service_manager import ServiceManager
from runtime.start_checks import require_px4, require_start
from runtime.stream_requests import StreamRequests
from runtime.stream_watch import StreamWatch
from runtime.supervisor import REQUEST_PATIENCE, SchedulingReport, Supervisor
from runtime.telemetry_buffer import TelemetryBuffer
from runtime.urgent_tick import UrgentTick

BACKGROUND_PRIORITY = 1  # of SCHED_FIFO, for recorder and supervisor
SETTLING_TIME = 1.5  # s, at most, in which clock and streams settle before their state is reported
STOP_PATIENCE = 1.0  # s until the link is closed under a control thread that does not end


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
        self._announcements = Announcements(announce)
        self._requests = Requests()
        self._engagement_requested = False
        self._recorder: Recorder | None = None
        self._telemetry = TelemetryBuffer()
        self._service = ServiceManager()

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
                self._recorder = self._announcements.recorder = self._open_recorder(request.record)
                stack.callback(self._recorder.close)
            self._service = ServiceManager.from_environment()
            stack.callback(self._service.close)
            self._telemetry = TelemetryBuffer(self._recorder)
            scheduling = stack.enter_context(realtime.Scheduling(request.priority))
            settings = LinkSettings(
                target_system=request.system,
                roaming=request.roaming,
                signing_key=request.signing_key,
                priority=scheduling.priority,
            )
            link = stack.enter_context(Link(request.endpoint, settings, self._telemetry.callbacks))
            # while the link listens
            controllers = build_controllers(self._vehicle, self._bundle, self._controller_options())
            warm_up(controllers, self._reference, request.plan, rate=request.rate)
            status = link.wait_for_vehicle(request.timeout)
            require_px4(status, self._announcements)
            link.require_one_vehicle()
            link.signing.require_common(link.peer.address)
            refusals = SchedulingReport(scheduling, self._announcements)
            flyer, control = self._prepare(link, controllers, scheduling, refusals)
            worker = RequestWorker(control.autopilot_requests, link_handlers(link), lambda: control.join(0.0))
            # before the first setpoint: whatever fails from now on parts
            stack.callback(self._stop, link, control, worker)
            self._fly_on(link, flyer, control, worker, refusals)
            return self._report(link, flyer, control, worker, scheduling)

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

    def _controller_options(self) -> ControllerOptions:
        return self._request.controller_options(self._vehicle, self._bundle)

    def _prepare(
        self, link: Link, controllers: Controllers, scheduling: realtime.Scheduling, refusals: SchedulingReport
    ) -> tuple[Flyer, ControlThread]:
        """Check the start, and build what flies; nothing is sent to the vehicle but requests for streams."""
        request, announce = self._request, self._announcements.line
        realtime.prepare_interpreter()
        scheduling.raise_all(BACKGROUND_PRIORITY, exempt="link")
        refusals.publish()
        request_rates(link, required_rates(request.rate))
        thrust_curve = read_thrust_curve(link, self._recorder, announce)
        loss_time = read_loss_time(link, self._recorder, announce)
        use_rate_gains(link, controllers, self._controller_options(), self._vehicle, self._recorder, announce)
        flyer = build_flyer(
            controllers,
            self._reference,
            request.plan,
            request.flyer_settings,
            thrust_curve=thrust_curve,
            loss_time=loss_time,
        )
        if request.adaptation.mode != "off":
            self._read_rotors(link, flyer)
        require_start(link, request, self._reference, self._vehicle, controllers.flying.trim, self._announcements)
        self._requests.slow_findings = self._settle(link)
        control = ControlThread(
            link,
            self._telemetry,
            flyer,
            self._requests,
            period=1.0 / request.rate,
            priority=scheduling.priority,
            processor=request.processor,
            recorder=self._recorder,
            urgent=UrgentTick.of(link, flyer),
        )
        return flyer, control

    def _read_rotors(self, link: Link, flyer: Flyer) -> None:
        """Let speeds of the rotors reach the flight, where it is clear which motor is which rotor."""
        rotors = self._vehicle.rotors
        flyer.motors = motor_of_rotors(rotors, motor_positions(link, rotors.count))
        if flyer.motors is None:
            self._announcements.line("which motor is which rotor is not clear: a rotor that loses thrust is not named")
        else:
            self._telemetry.rotor_reader = RotorReader(flyer.motors, partial(rotor_speed, rotors=rotors))

    def _settle(self, link: Link) -> dict[Event, str]:
        """Wait a moment for the clock and the requested streams. Returns what is still missing."""
        deadline = time.monotonic() + SETTLING_TIME
        while (present := self._slow_findings(link, time.monotonic())) and time.monotonic() < deadline:
            time.sleep(0.02)
        return present

    # --- during the flight

    def _fly_on(
        self, link: Link, flyer: Flyer, control: ControlThread, worker: RequestWorker, refusals: SchedulingReport
    ) -> None:
        """Start the control thread and the worker that passes its requests on, and supervise until it is done."""
        self._engagement_requested = True
        self._requests.engage = True
        control.start()
        worker.start()
        self._service.ready()
        rates = {**required_rates(self._request.rate), **SLOW_STREAMS}
        streams = StreamRequests(partial(request_rates, link), rates)
        streams.send(time.monotonic())
        feed = NotificationFeed(self._announcements, link, self._telemetry, control, worker, self._service)
        supervisor = Supervisor(
            link,
            control,
            worker,
            flyer.engagement,
            self._requests,
            slow_checks=partial(self._slow_findings, link),
            streams=streams,
            feed=feed,
            scheduling=refusals,
            announcements=self._announcements,
            service=self._service,
            timeout=self._request.timeout,
        )
        supervisor.serve()

    def _slow_findings(self, link: Link, now: float) -> dict[Event, str]:
        rate = self._request.rate
        self._requests.estimates_keep_up = estimates_keep_up(self._telemetry, rate=rate, now=now)
        return slow_findings(link, self._telemetry, self._recorder, rate=rate, now=now)

    # --- after the flight

    def _stop(self, link: Link, control: ControlThread, worker: RequestWorker) -> None:
        """End the control thread: no setpoint leaves after this, whatever ended the flight, but those it may hold."""
        self._requests.stop = True
        if control.join(STOP_PATIENCE):
            self._service.stopping()
            worker.join(REQUEST_PATIENCE)
        else:
            StreamWatch(control, link).end_stream()
            link.close()
            self._announcements.line(f"the control thread did not end within {STOP_PATIENCE:g} s: its link was closed")
            self._service.stopping()

    def _report(
        self, link: Link, flyer: Flyer, control: ControlThread, worker: RequestWorker, scheduling: realtime.Scheduling
    ) -> FlightReport:
        if loss := flyer.events.active.get(Event.ROTOR_FAILING):
            folder, text = None, loss
            if self._recorder is not None:
                folder, text = self._recorder.path.parent, f"{loss} ({self._recorder.path.name})"
            self._announcements.line(leave_note(folder, self._vehicle.name, text))
        return flight_report(
            flyer,
            control,
            link.status,
            refusal=worker.refusal,
            leave=self._requests.leave,
            recording=str(self._recorder.path) if self._recorder is not None else None,
            estimate_rate=self._telemetry.estimate_rate(time.monotonic()),
            started=self._announcements.started,
            scheduling=scheduling.describe(),
        )
