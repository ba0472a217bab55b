"""The report on a link: its measured state, and the problems that would refuse a flight. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from math import isnan
from typing import Literal

import msgspec

from dynamics.vehicle import GRAVITY
from runtime.link.rates import StreamRate
from runtime.link.telemetry import LinkEvent, VehicleStatus

MIN_RATE_SHARE = 0.9  # of the requested rate
MAX_ROUND_TRIP = 0.02  # s
MAX_TILT_ERROR = 10.0  # degrees
MAX_FORCE_ERROR = 1.0  # m/s^2
MAX_LOSS_TIME = 2.0  # s, of COM_OF_LOSS_T
_EXPECTED_EVENTS = ("mode_changed", "vehicle_found", "landed_state", "armed", "disarmed", "vehicle_heard_again")


class StreamCheck(msgspec.Struct, frozen=True):
    """The check of one message stream.

    name: of the message.
    before: rate before the request, Hz.
    requested: Hz.
    answer: to the request, a result's name.
    after: the rate that then arrived.
    """

    name: str
    before: float
    requested: float = msgspec.field(name="asked")
    answer: str
    after: StreamRate


class ClockCheck(msgspec.Struct, frozen=True):
    """The check of the vehicle's clock.

    answered: whether TIMESYNC is.
    settled: whether the filter's result is valid.
    round_trip: median, s.
    offset: vehicle's time minus ours, s.
    uncertainty: standard deviation of the offset, s.
    drift: s/s.
    """

    answered: bool
    settled: bool
    round_trip: float
    offset: float
    uncertainty: float
    drift: float


class AttitudeCheck(msgspec.Struct, frozen=True):
    """Length of the specific force at rest, m/s^2, and its angle to the estimated vertical, degrees."""

    specific_force: float
    tilt_error_degrees: float


class LinkProblem(msgspec.Struct, frozen=True):
    """A problem of the link. An error would refuse a flight; a warning should be understood before one."""

    severity: Literal["error", "warning"]
    text: str


class LinkReport(msgspec.Struct, frozen=True):
    """The outcome of the check of a link.

    endpoint: the connection string.
    vehicle: its identity and state.
    others: further senders on the link, "system/component" to kind.
    streams, clock, attitude: their checks.
    odometry_frames: frame and child frame of ODOMETRY, None without any.
    estimate_source: the message that gives estimates, None without any.
    position_world: m, of the newest estimate.
    parameters: of PX4 that matter to a flight, or why they could not be read.
    acknowledgements_of_mode: to one request of the present mode, two in some versions of PX4; 0 without a request.
    events: of the link during the check.
    problems: errors and warnings.
    frames, unknown_frames, skipped_bytes: counts over the whole check.
    """

    endpoint: str
    vehicle: VehicleStatus
    others: dict[str, str]
    streams: tuple[StreamCheck, ...]
    clock: ClockCheck
    odometry_frames: tuple[str, str] | None
    estimate_source: str | None
    position_world: tuple[float, float, float] | None
    attitude: AttitudeCheck | None
    parameters: dict[str, float | str]
    acknowledgements_of_mode: int
    events: tuple[LinkEvent, ...]
    problems: tuple[LinkProblem, ...]
    frames: int
    unknown_frames: int
    skipped_bytes: int

    @property
    def is_ready(self) -> bool:
        """Whether no problem is an error."""
        return not any(problem.severity == "error" for problem in self.problems)


def link_problems(
    streams: tuple[StreamCheck, ...],
    clock: ClockCheck,
    status: VehicleStatus,
    attitude: AttitudeCheck | None,
    parameters: Mapping[str, float | str],
    events: tuple[LinkEvent, ...],
    *,
    has_estimate: bool,
) -> tuple[LinkProblem, ...]:
    """The problems of a link, from its checks. has_estimate: whether a state estimate arrived."""
    return (
        *_stream_problems(streams, has_estimate=has_estimate),
        *_clock_problems(clock),
        *_vehicle_problems(status, attitude),
        *_parameter_problems(parameters),
        *_event_problems(events),
    )


def _stream_problems(streams: tuple[StreamCheck, ...], *, has_estimate: bool) -> list[LinkProblem]:
    problems = []
    if not has_estimate:
        text = (
            "No state estimate arrived. PX4 sends ODOMETRY on its offboard link once its estimator has a position: "
            "check GPS, motion capture or optical flow, and EKF2's status."
        )
        problems.append(LinkProblem("error", text))
    for stream in streams:
        if stream.after.rate < MIN_RATE_SHARE * stream.requested:
            severity: Literal["error", "warning"] = "error" if stream.name == "ODOMETRY" else "warning"
            text = (
                f"{stream.name} comes at {stream.after.rate:.0f} Hz, {stream.requested:.0f} Hz were requested (answer: "
                f"{stream.answer}). Raise the link's baud rate or MAV_n_RATE; PX4 in simulation only has rates that "
                "divide 250 Hz."
            )
            problems.append(LinkProblem(severity, text))
    return problems


def _clock_problems(clock: ClockCheck) -> list[LinkProblem]:
    if not clock.answered:
        return [LinkProblem("error", "TIMESYNC is not answered: the age of an estimate cannot be measured.")]
    if not clock.settled:
        text = (
            f"The vehicle's clock is not settled: uncertain by {clock.uncertainty * 1e3:.1f} ms, "
            f"round trip {clock.round_trip * 1e3:.1f} ms, drift {clock.drift * 1e3:.2f} ms/s."
        )
        return [LinkProblem("error", text)]
    if clock.round_trip > MAX_ROUND_TRIP:
        text = f"The round trip takes {clock.round_trip * 1e3:.0f} ms; on serial adapters look for a latency timer."
        return [LinkProblem("warning", text)]
    return []


def _vehicle_problems(status: VehicleStatus, attitude: AttitudeCheck | None) -> list[LinkProblem]:
    problems = []
    if status.autopilot != "px4":
        text = f"The autopilot is {status.autopilot}; this runtime supports PX4's modes and rules only."
        problems.append(LinkProblem("error", text))
    if status.system_status in ("critical", "emergency", "flight_termination", "calibrating", "boot"):
        problems.append(LinkProblem("error", f"The vehicle reports the state {status.system_status}."))
    if status.armed:
        problems.append(LinkProblem("warning", f"The vehicle is armed, in mode {status.mode}."))
    if isnan(status.battery_voltage):
        problems.append(LinkProblem("warning", "No battery voltage: thrust cannot be corrected for a sagging battery."))
    if attitude is not None and abs(attitude.specific_force - GRAVITY) > MAX_FORCE_ERROR:
        text = f"The accelerometer reads {attitude.specific_force:.1f} m/s^2 at rest, expected about {GRAVITY}."
        problems.append(LinkProblem("warning", text))
    if attitude is not None and attitude.tilt_error_degrees > MAX_TILT_ERROR:
        text = (
            f"At rest the attitude puts gravity {attitude.tilt_error_degrees:.0f} degrees off the vertical: "
            "wrong frames, or an estimator that has not converged."
        )
        problems.append(LinkProblem("error", text))
    return problems


def _parameter_problems(values: Mapping[str, float | str]) -> list[LinkProblem]:
    problems = []
    missing = [name for name, value in values.items() if isinstance(value, str)]
    if missing:
        text = f"Not read from the vehicle: {', '.join(missing)}; the defaults of PX4 are assumed."
        problems.append(LinkProblem("warning", text))
    loss, action = values.get("COM_OF_LOSS_T"), values.get("COM_OBL_RC_ACT")
    if isinstance(loss, float) and loss > MAX_LOSS_TIME:
        text = f"COM_OF_LOSS_T is {loss:g} s: so long the vehicle keeps to the last setpoint of a dead companion."
        problems.append(LinkProblem("warning", text))
    if action in (6, 7):
        what = "terminates the flight" if action == 6 else "disarms in the air"
        text = f"COM_OBL_RC_ACT is {action}: losing the companion {what}. 4 lands, 5 holds."
        problems.append(LinkProblem("warning", text))
    return problems


def _event_problems(events: tuple[LinkEvent, ...]) -> list[LinkProblem]:
    texts = {event.name: event for event in events if event.name not in _EXPECTED_EVENTS}
    return [
        LinkProblem(
            "error" if event.severity == "error" or event.name == "estimate_frame_refused" else "warning", event.text
        )
        for event in texts.values()
    ]
