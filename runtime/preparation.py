"""Preparation of a flight on a link, and the slow checks of one, against the clock or in simulated time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from dynamics.errors import VehicleError
from dynamics.vehicle import Vehicle
from runtime.autopilot_parameters import read_rate_gains
from runtime.control.controller import ControllerOptions
from runtime.flight.composition import Controllers, use_lookaheads
from runtime.flight.events import Event
from runtime.flight.health import estimator_health
from runtime.link.telemetry import EstimatorSample
from runtime.link.vehicle_link import VehicleLink
from runtime.rate_loop_check import oscillation_problem
from runtime.record.recorder import Recorder
from runtime.telemetry_buffer import TelemetryBuffer

MIN_RATE = 0.9  # of the rate of estimates that the flight requires
MAX_ESTIMATE_RATE = 100.0  # Hz, required at most, at any control rate: PX4 sends 124 Hz on a request for 200
ESTIMATOR_AGE = 2.0  # s for which an ESTIMATOR_STATUS counts
SLOW_STREAMS: Mapping[str, float] = {  # Hz; for the recording, and for what may arrive late
    "EXTENDED_SYS_STATE": 5.0,
    "BATTERY_STATUS": 2.0,
    "ESTIMATOR_STATUS": 2.0,
    "ESC_STATUS": 100.0,
    "SERVO_OUTPUT_RAW": 100.0,
    "ATTITUDE_TARGET": 20.0,  # whose setpoints the autopilot follows
}


def required_rates(rate: float) -> dict[str, float]:
    """Rates of the messages without which nothing flies, Hz. rate: of control, Hz."""
    return {"ODOMETRY": rate, "HIGHRES_IMU": min(rate, MAX_ESTIMATE_RATE)}


def use_rate_gains(
    link: VehicleLink,
    controllers: Controllers,
    options: ControllerOptions,
    vehicle: Vehicle,
    recorder: Recorder | None,
    announce: Callable[[str], None],
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Look ahead as far as the autopilot's own gains require.

    clock: of the flight, s. Raises VehicleError for a controller that would oscillate with them.
    """
    gains = read_rate_gains(link, vehicle, recorder, announce, clock)
    if gains is not None:
        use_lookaheads(controllers, options.for_autopilot(vehicle, gains))
    for controller in filter(None, controllers):
        problem = oscillation_problem(controller, vehicle, gains)
        if problem is not None and problem.severity == "error":
            raise VehicleError(f"The vehicle is not armed: {problem.text}")
        if problem is not None:
            announce(f"warning: {problem.text}")


def slow_findings(
    link: VehicleLink, telemetry: TelemetryBuffer, recorder: Recorder | None, *, rate: float, now: float
) -> dict[Event, str]:
    """Events that are present by the checks too slow for a tick. rate: of control, Hz. now: s."""
    present: dict[Event, str] = {}
    estimate_rate, required = telemetry.estimate_rate(now), min(rate, MAX_ESTIMATE_RATE)
    if estimate_rate < MIN_RATE * required:
        present[Event.RATES_LOW] = f"estimates come at {estimate_rate:.0f} Hz, {required:.0f} Hz are required"
    if not link.peer.clock.is_valid(now):
        present[Event.CLOCK_UNCERTAIN] = f"TIMESYNC uncertain by {1e3 * link.peer.clock.uncertainty(now):.1f} ms"
    estimator = link.peer.latest.get(EstimatorSample)
    if isinstance(estimator, EstimatorSample) and now - estimator.received < ESTIMATOR_AGE:
        present |= estimator_health(estimator)
    if recorder is not None and recorder.trouble:
        event = Event.RECORDER_OVERRUN if recorder.still_writing else Event.DISK_FULL
        present[event] = recorder.trouble
    return present


def estimates_keep_up(telemetry: TelemetryBuffer, *, rate: float, now: float) -> bool:
    """Whether estimates come about as often as ticks. rate: of control, Hz. now: s."""
    return telemetry.estimate_rate(now) >= MIN_RATE * rate
