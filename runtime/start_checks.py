"""The checks before a vehicle is engaged: its autopilot, the reference from where it stands, its conditions."""

from __future__ import annotations

import time

from dynamics.errors import RequestError, VehicleError
from dynamics.vehicle import Vehicle
from runtime.announcements import Announcements
from runtime.flight.composition import vehicle_facts
from runtime.flight.events import Event
from runtime.flight.motion import Motion
from runtime.flight.start_check import start_refusal
from runtime.flight_request import FlightRequest
from runtime.link.commands import request_rates
from runtime.link.link import Link
from runtime.link.start_conditions import STREAMS as START_STREAMS
from runtime.link.start_conditions import observe_start, start_problems
from runtime.link.telemetry import VehicleStatus


def require_px4(status: VehicleStatus, announcements: Announcements) -> None:
    """Announce the vehicle. Raises VehicleError for another autopilot than PX4."""
    announcements.line(f"vehicle {status.system}: {status.kind} with {status.autopilot}, mode {status.mode}")
    if status.autopilot != "px4":
        raise VehicleError(
            f"The autopilot is {status.autopilot}; only PX4's modes and OFFBOARD rules are supported. Nothing was sent."
        )


def require_start(
    link: Link, request: FlightRequest, reference: Motion, vehicle: Vehicle, trim: Vehicle, announcements: Announcements
) -> None:
    """Refuse a reference that leads from here into the ground or far away, and a vehicle that must not be armed.

    trim: the vehicle as it hovers. Raises RequestError for the reference, VehicleError for the vehicle.
    """
    estimate = link.wait_for_estimate(None, time.monotonic() + request.timeout)
    if estimate is None:
        return  # the check of rates refuses engagement instead
    on_ground = not link.status.armed
    reason = start_refusal(
        reference,
        estimate.position_world,
        on_ground=on_ground,
        from_here=on_ground and request.plan.origin == "takeoff",
        box=vehicle.limits.box,
    )
    if reason:
        announcements.event(Event.REFERENCE_INFEASIBLE, reason)
        raise RequestError(reason)
    _require_conditions(link, trim, announcements)


def _require_conditions(link: Link, trim: Vehicle, announcements: Announcements) -> None:
    """Refuse a vehicle that must not be armed as it stands; announce what should be understood before it flies."""
    request_rates(link, START_STREAMS)
    problems = start_problems(observe_start(link), vehicle_facts(trim))
    request_rates(link, dict.fromkeys(START_STREAMS, 0.0))
    for problem in problems:
        announcements.line(problem.text if problem.severity == "error" else f"warning: {problem.text}")
    refusals = [problem.text for problem in problems if problem.severity == "error"]
    if refusals:
        raise VehicleError(f"The vehicle is not armed: {' '.join(refusals)}")
