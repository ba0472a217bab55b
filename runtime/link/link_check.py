"""The check of a link without a flight: vehicle, rates, clock, and problems that would refuse a flight."""

from __future__ import annotations

import queue
import time
from collections.abc import Mapping
from math import acos, degrees, hypot, isnan
from typing import Literal

import msgspec

from dynamics import quaternion
from runtime.link import commands
from runtime.link.connection import Endpoint
from runtime.link.dialect import mavlink
from runtime.link.estimate import StateEstimate
from runtime.link.link import Link, LinkCallbacks, LinkSettings
from runtime.link.parameters import Parameter, read_parameters
from runtime.link.rates import WINDOW, StreamRate
from runtime.link.telemetry import ImuSample, LinkEvent, VehicleStatus

STREAMS: Mapping[str, float] = {"ODOMETRY": 100.0, "HIGHRES_IMU": 50.0, "ATTITUDE_QUATERNION": 50.0}
PARAMETERS = (
    "MPC_THR_HOVER", "THR_MDL_FAC", "COM_OF_LOSS_T", "COM_OBL_RC_ACT", "COM_DISARM_PRFLT",
    "MC_ROLLRATE_MAX", "MC_PITCHRATE_MAX", "MC_YAWRATE_MAX", "MC_ROLL_P", "MC_PITCH_P", "MC_YAW_P",
)  # fmt: skip
MIN_RATE_SHARE = 0.9  # of the requested rate
_GRAVITY = 9.81
_REST = 0.3  # m/s and rad/s below which the accelerometer shows gravity alone
_ACK_WINDOW = 0.3  # s in which a second acknowledgement follows the first


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
    acknowledgements_of_mode: to one request of the present mode; two in some versions of PX4.
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


def check_link(
    endpoint: Endpoint,
    *,
    timeout: float = 10.0,
    target_system: int | None = None,
    streams: Mapping[str, float] = STREAMS,
    window: float = WINDOW,
) -> LinkReport:
    """Listen to a vehicle, request its streams, and restore them. Sends no setpoint and arms nothing.

    timeout: s to wait for the vehicle. streams: message name to Hz. window: s over which rates are measured.
    Raises VehicleError when no vehicle is heard, RequestError for a message that does not exist.
    """
    events: list[LinkEvent] = []
    with Link(endpoint, LinkSettings(target_system=target_system), LinkCallbacks(event=events.append)) as link:
        link.wait_for_vehicle(timeout)
        time.sleep(window)
        before = {name: link.peer.rates.rate(name, time.monotonic(), window).rate for name in streams}
        answers = commands.request_rates(link, streams)
        requested_at = time.monotonic()
        parameters = read_parameters(link, PARAMETERS)
        acknowledgements = _count_acknowledgements(link)
        time.sleep(max(0.0, window - (time.monotonic() - requested_at)) + 0.1)
        now = time.monotonic()
        checks = tuple(
            StreamCheck(name, before[name], rate, answers[name], link.peer.rates.rate(name, now, window))
            for name, rate in streams.items()
        )
        report = _report(link, now, checks, parameters, acknowledgements, tuple(events))
        commands.request_rates(link, dict.fromkeys(streams, 0.0))
    return report


def _report(
    link: Link,
    now: float,
    streams: tuple[StreamCheck, ...],
    parameters: dict[str, Parameter],
    acknowledgements: int,
    events: tuple[LinkEvent, ...],
) -> LinkReport:
    peer, status, estimate = link.peer, link.status, link.estimate
    clock = ClockCheck(
        peer.clock.is_two_way,
        peer.clock.is_valid(now),
        peer.clock.round_trip,
        peer.clock.offset(now),
        peer.clock.uncertainty(now),
        peer.clock.drift,
    )
    imu = peer.latest.get(ImuSample)
    attitude = _check_attitude(estimate, imu) if estimate is not None and isinstance(imu, ImuSample) else None
    values = {
        name: parameter.error if parameter.value is None else parameter.value for name, parameter in parameters.items()
    }
    position = tuple(estimate.position_world.tolist()) if estimate is not None else None
    return LinkReport(
        endpoint=str(link.endpoint),
        vehicle=status,
        others={f"{s}/{c}": what for (s, c), what in sorted(peer.heard.items()) if (s, c) != peer.address},
        streams=streams,
        clock=clock,
        odometry_frames=_frame_names(peer.odometry_frames),
        estimate_source=estimate.source if estimate is not None else None,
        position_world=position,
        attitude=attitude,
        parameters=values,
        acknowledgements_of_mode=acknowledgements,
        events=events,
        problems=(
            *_stream_problems(streams, estimate),
            *_clock_problems(clock),
            *_vehicle_problems(status, attitude),
            *_parameter_problems(values),
            *_event_problems(events),
        ),
        frames=link.parser.frames,
        unknown_frames=link.parser.unknown,
        skipped_bytes=link.parser.skipped_bytes,
    )


def _frame_names(frames: tuple[int, int] | None) -> tuple[str, str] | None:
    if frames is None:
        return None
    names = [mavlink.enums["MAV_FRAME"].get(number) for number in frames]
    first, second = (
        str(number) if entry is None else entry.name.removeprefix("MAV_FRAME_")
        for number, entry in zip(frames, names, strict=True)
    )
    return first, second


def _check_attitude(estimate: StateEstimate, imu: ImuSample) -> AttitudeCheck | None:
    """The specific force's length, and its angle to world up, which is 0 at rest; None while the vehicle moves."""
    if hypot(*estimate.velocity_world) > _REST or hypot(*estimate.rate_body) > _REST:
        return None
    length = hypot(*imu.specific_force_body)
    if not length > 0:
        return AttitudeCheck(length, 180.0)
    up = float(quaternion.rotate(estimate.attitude, imu.specific_force_body)[2]) / length
    return AttitudeCheck(length, degrees(acos(max(-1.0, min(1.0, up)))))


def _count_acknowledgements(link: Link) -> int:
    """The number of acknowledgements to one request of the present mode; 0 without a request while armed."""
    status = link.status
    if status.armed or status.mode == "unknown":
        return 0
    command = mavlink.MAV_CMD_DO_SET_MODE
    parameters = (float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(status.main_mode), float(status.sub_mode))
    count, patience = 0, 1.0
    with link.listening(lambda message: commands.acknowledgement(link, message, command)) as answers:
        link.send(commands.command_message(link, command, 0, *parameters))
        while True:
            try:
                answers.get(timeout=patience)
            except queue.Empty:
                return count
            count, patience = count + 1, _ACK_WINDOW


def _stream_problems(streams: tuple[StreamCheck, ...], estimate: StateEstimate | None) -> list[LinkProblem]:
    problems = []
    if estimate is None:
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
    if clock.round_trip > 0.02:
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
    if attitude is not None and abs(attitude.specific_force - _GRAVITY) > 1.0:
        text = f"The accelerometer reads {attitude.specific_force:.1f} m/s^2 at rest, expected about {_GRAVITY}."
        problems.append(LinkProblem("warning", text))
    if attitude is not None and attitude.tilt_error_degrees > 10.0:
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
    if isinstance(loss, float) and loss > 2.0:
        text = f"COM_OF_LOSS_T is {loss:g} s: that long a dead companion would fly on with its last setpoint."
        problems.append(LinkProblem("warning", text))
    if action in (6, 7):
        what = "terminates the flight" if action == 6 else "disarms in the air"
        text = f"COM_OBL_RC_ACT is {action}: losing the companion {what}. 4 lands, 5 holds."
        problems.append(LinkProblem("warning", text))
    return problems


def _event_problems(events: tuple[LinkEvent, ...]) -> list[LinkProblem]:
    expected = ("mode_changed", "vehicle_found", "landed_state", "armed", "disarmed", "vehicle_heard_again")
    texts = {event.name: event for event in events if event.name not in expected}
    return [
        LinkProblem(
            "error" if event.severity == "error" or event.name == "estimate_frame_refused" else "warning", event.text
        )
        for event in texts.values()
    ]
