"""The check of a link without a flight: vehicle, rates, clock, parameters."""

from __future__ import annotations

import queue
import time
from collections.abc import Mapping
from math import isfinite

from dynamics.errors import VehicleError
from dynamics.signing_key import SigningKey
from runtime.link import commands
from runtime.link.connection import Endpoint
from runtime.link.dialect import mavlink
from runtime.link.link import Link, LinkCallbacks, LinkSettings
from runtime.link.link_report import AttitudeCheck, ClockCheck, LinkReport, StreamCheck, link_problems, signing_problems
from runtime.link.parameters import Parameter, read_parameters
from runtime.link.problem import Problem
from runtime.link.rates import WINDOW
from runtime.link.signing import is_private, not_private
from runtime.link.start_conditions import STREAMS as START_STREAMS
from runtime.link.start_conditions import StartFacts, VehicleFacts, observe_start, start_problems
from runtime.link.telemetry import LinkEvent, VehicleStatus

STREAMS: Mapping[str, float] = {"ODOMETRY": 100.0, "HIGHRES_IMU": 50.0, "ATTITUDE_QUATERNION": 50.0}
PARAMETERS = (
    "MPC_THR_HOVER",
    "THR_MDL_FAC",
    "COM_OF_LOSS_T",
    "COM_OBL_RC_ACT",
    "COM_DISARM_PRFLT",
    "MC_ROLLRATE_MAX",
    "MC_PITCHRATE_MAX",
    "MC_YAWRATE_MAX",
    "MC_ROLL_P",
    "MC_PITCH_P",
    "MC_YAW_P",
    "CA_ROTOR_COUNT",
)
_ACK_WINDOW = 0.3  # s in which a second acknowledgement follows the first


def check_link(
    endpoint: Endpoint,
    *,
    timeout: float = 10.0,
    target_system: int | None = None,
    streams: Mapping[str, float] = STREAMS,
    window: float = WINDOW,
    request_mode: bool = False,
    vehicle: VehicleFacts | None = None,
    signing_key: SigningKey | None = None,
) -> LinkReport:
    """Listen to a vehicle, request its streams on this link, and reset them to their default rates.

    Changes nothing else: no setpoint is sent, no mode requested, nothing armed.

    timeout: s to wait for the vehicle. streams: message name to Hz. window: s over which rates are measured.
    request_mode: whether to request a disarmed vehicle's present mode once more, to count the acknowledgements. A mode
        switched since its last heartbeat would be taken back.
    vehicle: what the autopilot's parameters must agree with, None to leave that out.
    signing_key: under which the link is signed, None for an unsigned one.
    Raises VehicleError when no vehicle is heard, or several without target_system, RequestError for a message that does
    not exist.
    """
    events: list[LinkEvent] = []
    settings = LinkSettings(target_system=target_system, signing_key=signing_key)
    with Link(endpoint, settings, LinkCallbacks(event=events.append)) as link:
        link.wait_for_vehicle(timeout)
        link.require_one_vehicle()
        time.sleep(window)
        before = {name: link.peer.rates.rate(name, time.monotonic(), window).rate for name in streams}
        answers = commands.request_rates(link, streams)
        commands.request_rates(link, START_STREAMS)
        requested_at = time.monotonic()
        parameters = read_parameters(link, PARAMETERS)
        acknowledgements = _count_acknowledgements(link) if request_mode else 0
        values = {name: float(each.value) for name, each in parameters.items() if each.value is not None}
        facts = observe_start(link, values)
        time.sleep(max(0.0, window - (time.monotonic() - requested_at)) + 0.1)
        now = time.monotonic()
        checks = tuple(
            StreamCheck(name, before[name], rate, answers[name], link.peer.rates.rate(name, now, window))
            for name, rate in streams.items()
        )
        start = start_problems(facts, vehicle)
        report = _report(link, now, checks, parameters, acknowledgements, tuple(events), facts, start)
        commands.request_rates(link, dict.fromkeys((*streams, *START_STREAMS), 0.0))
    return report


def set_up_signing(
    endpoint: Endpoint,
    key: SigningKey,
    *,
    present: SigningKey | None = None,
    timeout: float = 10.0,
    target_system: int | None = None,
) -> VehicleStatus:
    """Give a vehicle a key for signing, and wait until it signs with it. Returns the vehicle's status then.

    present: the key that the vehicle has, None for none. timeout: s to wait for the vehicle, and for its signature.
    Raises RequestError for an endpoint that reaches other machines, VehicleError for a vehicle that is not heard, is
    armed or does not take the key.
    """
    if not is_private(endpoint):
        raise not_private(endpoint)
    settings = LinkSettings(target_system=target_system, signing_key=present)
    with Link(endpoint, settings) as link:
        link.wait_for_vehicle(timeout)
        link.require_one_vehicle()
        if link.signing.report(link.peer.address).autopilot_signs and present is None:
            raise VehicleError(
                "The autopilot signs already, and only its present key can change that. Give this as --signing-key; "
                "if it is lost, remove the key file from the autopilot's SD card."
            )
        link.send_signing_setup(key)
        vehicle = link.status.system
    with Link(endpoint, LinkSettings(target_system=vehicle, signing_key=key)) as link:
        try:
            return link.wait_for_vehicle(timeout)
        except VehicleError as error:
            raise VehicleError(
                f"The key was sent, but the vehicle does not sign with it. Firmware that can is needed (PX4 of 2026). "
                f"{error}"
            ) from None


def _report(
    link: Link,
    now: float,
    streams: tuple[StreamCheck, ...],
    parameters: dict[str, Parameter],
    acknowledgements: int,
    events: tuple[LinkEvent, ...],
    facts: StartFacts,
    start: tuple[Problem, ...],
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
    stands = facts.standing
    attitude = None
    if stands is not None and isfinite(stands.specific_force):
        attitude = AttitudeCheck(stands.specific_force, stands.gravity_angle)
    values = {
        name: parameter.error if parameter.value is None else parameter.value for name, parameter in parameters.items()
    }
    signing = link.signing.report(peer.address)
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
            *signing_problems(signing),
            *link_problems(streams, clock, status, values, events, start, has_estimate=estimate is not None),
        ),
        frames=link.parser.frames,
        unknown_frames=link.parser.unknown,
        skipped_bytes=link.parser.skipped_bytes,
        signing=signing,
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
