"""What the mock does with each message that it receives; all others are ignored, as by PX4."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from sitl_mock.autopilot import commands
from sitl_mock.autopilot.commander import Result
from sitl_mock.autopilot.modes import mode_from_custom
from sitl_mock.autopilot.offboard import attitude_target, global_position_target, position_target
from sitl_mock.wire.dialect import AUTOPILOT_COMPONENT, Message, mavlink
from sitl_mock.wire.link import Link

if TYPE_CHECKING:
    from sitl_mock.autopilot.autopilot import Autopilot

ACK_DELAY = (0.0005, 0.0145)  # s; measured 0.5 to 16 ms
SECOND_ACK_DELAY = (0.0, 0.007)
SECOND_VALUE_DELAY = (0.0145, 0.022)  # s; measured 14 to 23 ms
LIST_SPACING = 0.002  # s between two parameters of a list


def receive(autopilot: Autopilot, link: Link, time: float, message: Message) -> None:
    """Handle one message that arrived on a link at a simulated time, s."""
    handler = HANDLERS.get(message.get_type())
    if handler is None or _is_own(autopilot, message):
        return
    try:
        handler(autopilot, link, time, message)
    except (ValueError, OverflowError):
        link.bad_frames += 1  # a number that no field of ours can take


def _is_own(autopilot: Autopilot, message: Message) -> bool:
    return bool(message.get_srcSystem() == autopilot.system and message.get_srcComponent() == AUTOPILOT_COMPONENT)


def _asker(message: Message) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _is_meant(autopilot: Autopilot, message: Message) -> bool:
    return message.target_system in (0, autopilot.system) and message.target_component in (0, AUTOPILOT_COMPONENT)


def _heartbeat(_: Autopilot, link: Link, time: float, message: Message) -> None:
    link.hear_heartbeat(time, message.type)


def _timesync(autopilot: Autopilot, link: Link, time: float, message: Message) -> None:
    if message.tc1 == 0:
        reply = mavlink.MAVLink_timesync_message(autopilot.clock.nanoseconds(time), message.ts1)
        link.send(time, reply)


def _ping(autopilot: Autopilot, link: Link, time: float, message: Message) -> None:
    if message.target_system == 0 and message.target_component == 0:
        link.send(
            time,
            mavlink.MAVLink_ping_message(message.time_usec, message.seq, *_asker(message)),
        )


def _attitude_target(autopilot: Autopilot, _: Link, time: float, message: Message) -> None:
    if _is_meant(autopilot, message):
        setpoint = attitude_target(message)
        if setpoint is not None:
            autopilot.commander.offboard.feed(time, autopilot.estimate_fault.meant(setpoint))


def _position_target(autopilot: Autopilot, _: Link, time: float, message: Message) -> None:
    if _is_meant(autopilot, message):
        setpoint = position_target(message, autopilot.vehicle.estimate.attitude)
        if setpoint is not None:
            autopilot.commander.offboard.feed(time, autopilot.estimate_fault.meant(setpoint))


def _global_position_target(autopilot: Autopilot, _: Link, time: float, message: Message) -> None:
    if _is_meant(autopilot, message):
        setpoint = global_position_target(message)
        if setpoint is not None:
            autopilot.commander.offboard.feed(time, autopilot.estimate_fault.meant(setpoint))


def _command(autopilot: Autopilot, link: Link, time: float, message: Message) -> None:
    if not commands.is_meant(message, autopilot.system):
        return
    result = commands.execute(autopilot, commands.command_of(message, time, link))
    _acknowledge(autopilot, link, time, message, message.command, result)


def _set_mode(autopilot: Autopilot, link: Link, time: float, message: Message) -> None:
    if message.target_system != autopilot.system:
        return
    mode = mode_from_custom(message.base_mode, message.custom_mode)
    result = autopilot.commander.set_mode(time, mode)
    _acknowledge(autopilot, link, time, message, mavlink.MAV_CMD_DO_SET_MODE, result)


def _acknowledge(autopilot: Autopilot, link: Link, time: float, message: Message, command: int, result: Result) -> None:
    asker = _asker(message)
    at = link.in_order(time + autopilot.random.uniform(*ACK_DELAY))
    if autopilot.double_ack and command == mavlink.MAV_CMD_DO_SET_MODE:
        link.send(at, mavlink.MAVLink_command_ack_message(command, Result.ACCEPTED, 0, 0, *asker))
        at = link.in_order(at + autopilot.random.uniform(*SECOND_ACK_DELAY))
    link.send(at, mavlink.MAVLink_command_ack_message(command, result, 0, 0, *asker))


def _name(message: Message) -> str:
    raw = message.param_id
    return raw if isinstance(raw, str) else bytes(raw).split(b"\0")[0].decode("ascii", "replace")


def _parameter_list(autopilot: Autopilot, link: Link, time: float, message: Message) -> None:
    if _is_meant(autopilot, message) and link.may_list(time, len(autopilot.parameters) * LIST_SPACING):
        for index, name in enumerate(autopilot.parameters.names):
            link.send(time + index * LIST_SPACING, autopilot.parameters.value_message(name))


def _parameter_read(autopilot: Autopilot, link: Link, time: float, message: Message) -> None:
    if _is_meant(autopilot, message):
        link.send(time, autopilot.parameters.read(_name(message), message.param_index, _asker(message)))


def _parameter_set(autopilot: Autopilot, link: Link, time: float, message: Message) -> None:
    if not _is_meant(autopilot, message):
        return
    name = _name(message)
    answer, changed = autopilot.parameters.set(name, message.param_value, message.param_type, _asker(message))
    link.send(time, answer)
    if changed:
        autopilot.apply_parameters()
        again = time + autopilot.random.uniform(*SECOND_VALUE_DELAY)
        for other in autopilot.links:
            other.send(again, autopilot.parameters.value_message(name))


def _mission_list(autopilot: Autopilot, link: Link, time: float, message: Message) -> None:
    if _is_meant(autopilot, message):
        kind = getattr(message, "mission_type", 0)
        link.send(time, mavlink.MAVLink_mission_count_message(*_asker(message), 0, kind))


HANDLERS: dict[str, Callable[[Autopilot, Link, float, Message], None]] = {
    "HEARTBEAT": _heartbeat,
    "TIMESYNC": _timesync,
    "PING": _ping,
    "SET_ATTITUDE_TARGET": _attitude_target,
    "SET_POSITION_TARGET_LOCAL_NED": _position_target,
    "SET_POSITION_TARGET_GLOBAL_INT": _global_position_target,
    "COMMAND_LONG": _command,
    "COMMAND_INT": _command,
    "SET_MODE": _set_mode,
    "PARAM_REQUEST_LIST": _parameter_list,
    "PARAM_REQUEST_READ": _parameter_read,
    "PARAM_SET": _parameter_set,
    "MISSION_REQUEST_LIST": _mission_list,
}
