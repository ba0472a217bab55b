"""The report on a link: its measured state, and the problems that would refuse a flight. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from math import isnan
from typing import Literal

import msgspec

from runtime.link.problem import Problem
from runtime.link.rates import StreamRate
from runtime.link.signing import TAKES_SIGNED_ALONE, SigningReport
from runtime.link.telemetry import LinkEvent, VehicleStatus

MIN_RATE_SHARE = 0.9  # of the requested rate
MAX_ROUND_TRIP = 0.02  # s
MAX_SIGNING_LEAD = 60.0  # s by which a new stream may be behind its receiver (mavlink.io, Message Signing)
_REFUSING_EVENTS = ("estimate_frame_refused", "estimate_stamp_ahead")
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
    signing: whether signatures are required, and how many frames were accepted and refused.
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
    problems: tuple[Problem, ...]
    frames: int
    unknown_frames: int
    skipped_bytes: int
    signing: SigningReport = SigningReport()

    @property
    def is_ready(self) -> bool:
        """Whether no problem is an error."""
        return not any(problem.severity == "error" for problem in self.problems)


def link_problems(
    streams: tuple[StreamCheck, ...],
    clock: ClockCheck,
    status: VehicleStatus,
    parameters: Mapping[str, float | str],
    events: tuple[LinkEvent, ...],
    start: tuple[Problem, ...] = (),
    *,
    has_estimate: bool,
) -> tuple[Problem, ...]:
    """The problems of a link, from its checks.

    start: those against arming (runtime.link.start_conditions). has_estimate: whether a state estimate arrived.
    """
    return (
        *_stream_problems(streams, has_estimate=has_estimate),
        *_clock_problems(clock),
        *_vehicle_problems(status),
        *start,
        *_parameter_problems(parameters),
        *_event_problems(events),
    )


def _stream_problems(streams: tuple[StreamCheck, ...], *, has_estimate: bool) -> list[Problem]:
    problems = []
    if not has_estimate:
        text = (
            "No state estimate arrived. PX4 sends ODOMETRY on its offboard link once its estimator has a position: "
            "check GPS, motion capture or optical flow, and EKF2's status."
        )
        problems.append(Problem("error", text))
    for stream in streams:
        if stream.after.rate < MIN_RATE_SHARE * stream.requested:
            severity: Literal["error", "warning"] = "error" if stream.name == "ODOMETRY" else "warning"
            text = (
                f"{stream.name} comes at {stream.after.rate:.0f} Hz, {stream.requested:.0f} Hz were requested (answer: "
                f"{stream.answer}). Raise the link's baud rate or MAV_n_RATE; PX4 in simulation only has rates that "
                "divide 250 Hz."
            )
            problems.append(Problem(severity, text))
    return problems


def _clock_problems(clock: ClockCheck) -> list[Problem]:
    if not clock.answered:
        return [Problem("error", "TIMESYNC is not answered: the age of an estimate cannot be measured.")]
    if not clock.settled:
        text = (
            f"The vehicle's clock is not settled: uncertain by {clock.uncertainty * 1e3:.1f} ms, "
            f"round trip {clock.round_trip * 1e3:.1f} ms, drift {clock.drift * 1e3:.2f} ms/s."
        )
        return [Problem("error", text)]
    if clock.round_trip > MAX_ROUND_TRIP:
        text = f"The round trip takes {clock.round_trip * 1e3:.0f} ms; on serial adapters look for a latency timer."
        return [Problem("warning", text)]
    return []


def signing_problems(signing: SigningReport) -> tuple[Problem, ...]:
    """The problems of a link's signatures; refused frames are among its events."""
    if signing.autopilot_signs and not signing.required:
        return (Problem("error", f"The autopilot {TAKES_SIGNED_ALONE}"),)
    if signing.lead > MAX_SIGNING_LEAD:
        text = (
            f"The timestamps of signing are {signing.lead:.0f} s ahead of this computer's clock, as a clock that was "
            "set back or an autopilot that is ahead leaves them: other computers' frames count as outdated. Set this "
            "computer's clock; if it is right, make a new key."
        )
        return (Problem("warning", text),)
    return ()


def _vehicle_problems(status: VehicleStatus) -> list[Problem]:
    problems = []
    if status.autopilot != "px4":
        text = f"The autopilot is {status.autopilot}; this runtime supports PX4's modes and rules only."
        problems.append(Problem("error", text))
    if status.system_status in ("critical", "emergency", "flight_termination", "calibrating", "boot"):
        problems.append(Problem("error", f"The vehicle reports the state {status.system_status}."))
    if status.armed:
        problems.append(Problem("warning", f"The vehicle is armed, in mode {status.mode}."))
    if isnan(status.battery_voltage):
        problems.append(Problem("warning", "No battery voltage: thrust cannot be corrected for a sagging battery."))
    return problems


def _parameter_problems(values: Mapping[str, float | str]) -> list[Problem]:
    problems = []
    missing = [name for name, value in values.items() if isinstance(value, str)]
    if missing:
        text = f"Not read from the vehicle: {', '.join(missing)}; the defaults of PX4 are assumed."
        problems.append(Problem("warning", text))
    return problems


def _event_problems(events: tuple[LinkEvent, ...]) -> list[Problem]:
    texts = {event.name: event for event in events if event.name not in _EXPECTED_EVENTS}
    return [
        Problem("error" if event.severity == "error" or event.name in _REFUSING_EVENTS else "warning", event.text)
        for event in texts.values()
    ]
