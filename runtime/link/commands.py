"""Commands to the vehicle: message rates, modes, arming. HEARTBEAT decides, not an acknowledgement.

Some PX4 versions acknowledge a mode change twice, first with an unconditional ACCEPTED (docs/px4.md, arming and modes).
So an acknowledgement counts only when it refuses.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping

import msgspec

from dynamics.errors import RequestError
from runtime.link import modes
from runtime.link.dialect import MESSAGE_IDS, Message, mavlink
from runtime.link.link import Link
from runtime.link.telemetry import VehicleStatus, enum_name
from runtime.link.vehicle_link import ATTEMPTS, NO_ANSWER, VehicleLink

_FORCE = 21196.0  # param2 of MAV_CMD_COMPONENT_ARM_DISARM: regardless of checks, and of being in the air
_RESEND_PERIOD = 0.5  # s without an answer
_HANDLING_TIME = 0.3  # s that a refusal waits for a heartbeat that contradicts it


class Confirmation(msgspec.Struct, frozen=True):
    """The outcome of a command.

    confirmed: whether HEARTBEAT shows it.
    acknowledgements: that came, as result names.
    reason: why it is not confirmed, empty when it is.
    """

    confirmed: bool
    acknowledgements: tuple[str, ...] = ()
    reason: str = ""


def command_message(link: VehicleLink, command: int, attempt: int, *parameters: float) -> Message:
    """COMMAND_LONG to the vehicle. parameters: up to seven, the others are 0."""
    status = link.status
    values = (*parameters, *(0.0,) * (7 - len(parameters)))
    return mavlink.MAVLink_command_long_message(status.system, status.component, command, attempt, *values)


def acknowledgement(link: VehicleLink, message: Message, command: int) -> str | None:
    """The result's name, such as accepted, if a message acknowledges this command to us; None otherwise."""
    if message.get_type() != "COMMAND_ACK" or message.command != command:
        return None
    if message.target_system not in (0, link.own_system):
        return None
    if message.target_component not in (0, link.own_component):
        return None
    return enum_name("MAV_RESULT", message.result, "MAV_RESULT_")


def send_command(
    link: VehicleLink, command: int, *parameters: float, timeout: float = 0.5, attempts: int = ATTEMPTS
) -> str:
    """Send a command until it is acknowledged. Returns the result's name, or no_answer.

    For modes and arming use set_mode and set_armed: a first acknowledgement may be wrong there.
    """

    def request(attempt: int) -> Message:
        return command_message(link, command, attempt, *parameters)

    def read(message: Message) -> str | None:
        result = acknowledgement(link, message, command)
        return None if result == "in_progress" else result

    return link.exchange(request, read, timeout=timeout, attempts=attempts) or NO_ANSWER


def request_rates(link: VehicleLink, rates: Mapping[str, float]) -> dict[str, str]:
    """Request message rates. Returns the results' names; the rates that arrive are in link.peer.rates.

    After one without an answer the others are sent once each: the vehicle may act without answering.

    rates: message name to Hz, 0 for the vehicle's default.
    Raises RequestError for a message that MAVLink does not have.
    """
    unknown = sorted(name for name in rates if name not in MESSAGE_IDS)
    if unknown:
        raise RequestError(f"No MAVLink message is called {', '.join(unknown)}. Give names such as ODOMETRY.")
    interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    results: dict[str, str] = {}
    for name, rate in rates.items():
        period = round(1e6 / rate) if rate > 0 else 0  # us
        attempts = 1 if NO_ANSWER in results.values() else ATTEMPTS
        results[name] = send_command(link, interval, MESSAGE_IDS[name], period, attempts=attempts)
    return results


def set_mode(link: Link, mode: str, timeout: float = 3.0) -> Confirmation:
    """Request a PX4 mode until HEARTBEAT shows it. mode: name, such as OFFBOARD, HOLD or LAND. timeout: s.

    Raises RequestError for a mode that PX4 does not have.
    """
    command, (custom, main, sub) = mode_command(mode)
    return _confirm(
        link,
        command,
        (custom, main, sub),
        lambda status: (status.main_mode, status.sub_mode) == (main, sub),
        f"mode {mode.upper()}",
        timeout,
    )


def mode_command(mode: str) -> tuple[int, tuple[float, float, float]]:
    """Number and parameters of the command for a PX4 mode. Raises RequestError for one that PX4 does not have."""
    try:
        main, sub = modes.mode_numbers(mode)
    except KeyError:
        raise RequestError(f"'{mode}' is no mode of PX4. Give a name such as OFFBOARD, HOLD, RTL or LAND.") from None
    custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
    return mavlink.MAV_CMD_DO_SET_MODE, (custom, float(main), float(sub))


def arming_command(armed: bool, *, force: bool = False) -> tuple[int, tuple[float, float]]:
    """Number and parameters of the command to arm or disarm. force: regardless of the autopilot's checks."""
    return mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (float(armed), _FORCE if force else 0.0)


def set_armed(link: Link, armed: bool, *, force: bool = False, timeout: float = 3.0) -> Confirmation:
    """Request arming or disarming until HEARTBEAT shows it. force: regardless of the autopilot's checks. timeout: s."""
    command, parameters = arming_command(armed, force=force)
    return _confirm(
        link,
        command,
        parameters,
        lambda status: status.armed == armed,
        "arming" if armed else "disarming",
        timeout,
    )


def _confirm(
    link: Link,
    command: int,
    parameters: tuple[float, ...],
    is_done: Callable[[VehicleStatus], bool],
    what: str,
    timeout: float,
) -> Confirmation:
    started = time.monotonic()
    deadline, refused_until = started + timeout, float("inf")
    acknowledgements: list[str] = []

    def read(message: Message) -> str | None:
        if message.get_type() in ("HEARTBEAT", "CURRENT_MODE"):
            return ""
        return acknowledgement(link, message, command)

    with link.listening(read) as answers:
        link.send(command_message(link, command, 0, *parameters))
        attempt, resend = 0, started + _RESEND_PERIOD
        while (now := time.monotonic()) < min(deadline, refused_until):
            try:
                answer = answers.get(timeout=max(0.0, min(deadline, refused_until, resend) - now))
            except queue.Empty:
                if time.monotonic() >= resend and not acknowledgements:
                    attempt += 1
                    link.send(command_message(link, command, attempt, *parameters))
                resend = time.monotonic() + _RESEND_PERIOD
                continue
            if answer:
                acknowledgements.append(answer)
                refused = answer not in ("accepted", "in_progress")
                refused_until = time.monotonic() + _HANDLING_TIME if refused else float("inf")
            elif is_done(link.status):
                return Confirmation(True, tuple(acknowledgements))
    return Confirmation(False, tuple(acknowledgements), _reason(what, acknowledgements, timeout))


def _reason(what: str, acknowledgements: list[str], timeout: float) -> str:
    if not acknowledgements:
        return f"The vehicle did not answer the request for {what} within {timeout:g} s."
    if acknowledgements[-1] in ("accepted", "in_progress"):
        return f"The vehicle acknowledged {what}, but its heartbeat did not show it within {timeout:g} s."
    advice = {
        "mode OFFBOARD": " PX4 requires a stream of setpoints above 2 Hz for a second before it.",
        "arming": " PX4 sends the reason to a ground station by STATUSTEXT; in OFFBOARD it arms only with a stream.",
        "disarming": " In the air it is refused unless forced.",
    }.get(what, "")
    return f"The vehicle refused {what}: {acknowledgements[-1]}.{advice}"
