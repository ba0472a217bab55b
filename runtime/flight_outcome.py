"""The report of a flight, from what flew it."""

from __future__ import annotations

import time
from math import isnan

import msgspec

from runtime.control.adaptation import Followed
from runtime.control_thread import ControlThread
from runtime.flight.flyer import Flyer
from runtime.flight_request import FlightReport
from runtime.link.link import LinkSettings
from runtime.link.telemetry import VehicleStatus

MODE_DELAY = 1.5  # s by which HEARTBEAT, at 1 Hz, may show a mode late


def flight_report(
    flyer: Flyer,
    control: ControlThread,
    status: VehicleStatus,
    *,
    refusal: str,
    leave: str,
    recording: str | None,
    estimate_rate: float,
    started: float,
    scheduling: str,
) -> FlightReport:
    """Report a flight that is over.

    status: the vehicle's. refusal: of the last request to the autopilot. leave: why a landing was requested.
    estimate_rate: Hz. started: s, monotonic. scheduling: in words.
    """
    landed, cut_short = flyer.landed and not status.armed, flyer.mission.landing_reason
    start_up, origin = control.first_setpoint - started, flyer.mission.origin
    return FlightReport(
        outcome=_outcome(flyer, control, refusal) + _left_behind(status),
        landed=landed,
        completed=landed and cut_short in ("", leave),
        landing_reason=cut_short,
        recording=recording,
        tracking=control.tracking.report(),
        timing=control.deadlines.report(),
        estimate_rate=estimate_rate,
        events={event.value: count for event, count in flyer.events.counts.items() if count},
        effectiveness=flyer.effectiveness.value if flyer.landed else flyer.effectiveness.earlier(MODE_DELAY),
        start_up=-1.0 if isnan(start_up) else start_up,
        scheduling=scheduling,
        origin=(float(origin[0]), float(origin[1]), float(origin[2])),
        followed=_followed(flyer),
    )


def _outcome(flyer: Flyer, control: ControlThread, refusal: str) -> str:
    outcome = flyer.engagement.refusal or "stopped streaming at once"
    if refusal and not flyer.landed:
        outcome = f"{outcome}: {refusal}"
    return f"{outcome}; a defect of the daemon: {control.defect}" if control.defect else outcome


def _followed(flyer: Flyer) -> Followed | None:
    if (adaptation := flyer.controllers.adaptation) is None:
        return None
    return msgspec.structs.replace(adaptation.followed, parameters=flyer.controllers.followed)


def _left_behind(status: VehicleStatus) -> str:
    """Suffix: state of a vehicle left armed, in brackets; empty for a disarmed one."""
    silence = time.monotonic() - status.last_heard
    if silence > LinkSettings().silence:
        state = f"{'armed' if status.armed else 'disarmed'} in {status.mode}"
        return (
            f" (the vehicle has been silent for {silence:.1f} s, and was {state} before: its own failsafe has it, "
            "if its autopilot still runs)"
        )
    return f" (the vehicle is armed, mode {status.mode}: the autopilot or the pilot has it)" if status.armed else ""
