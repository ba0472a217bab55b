"""MAVLink commands (COMMAND_LONG, COMMAND_INT): what PX4 does on each, and with which result it answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sitl_mock.autopilot.commander import FORCE, Result
from sitl_mock.autopilot.modes import Mode, mode_from_command
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
from sitl_mock.wire import telemetry
from sitl_mock.wire.dialect import AUTOPILOT_COMPONENT, Message, ProtocolVersion, mavlink
from sitl_mock.wire.snapshot import ORIGIN_ALTITUDE, local_from_global
from sitl_mock.wire.wire_axes import enu_from_ned

if TYPE_CHECKING:
    from sitl_mock.autopilot.autopilot import Autopilot
    from sitl_mock.wire.link import Link

_M = mavlink
TO_ANY_COMPONENT = frozenset(
    {
        _M.MAV_CMD_REQUEST_MESSAGE,
        _M.MAV_CMD_REQUEST_PROTOCOL_VERSION,
        _M.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
    }
)


@dataclass(frozen=True, slots=True)
class Command:
    """A command as it arrived. parameters: the seven, latitude and longitude as 1e-7 degrees. time: s."""

    identifier: int
    parameters: tuple[float, ...]
    time: float
    link: Link

    def whole(self, number: int) -> int:
        """Parameter 1..7 as an integer, 0 where it is not a finite number."""
        value = self.parameters[number - 1]
        return round(value) if math.isfinite(value) else 0


def command_of(message: Message, time: float, link: Link) -> Command:
    """The command in a COMMAND_LONG or COMMAND_INT."""
    first = (message.param1, message.param2, message.param3, message.param4)
    if message.get_type() == "COMMAND_INT":
        last = (float(message.x), float(message.y), message.z)
    else:
        last = (message.param5 * 1e7, message.param6 * 1e7, message.param7)
    return Command(message.command, (*first, *last), time, link)


def is_meant(message: Message, system: int) -> bool:
    """Whether a command is addressed to this autopilot."""
    if message.command in TO_ANY_COMPONENT:
        return message.target_system in (0, system)
    return message.target_system == system and message.target_component in (0, AUTOPILOT_COMPONENT)


def execute(autopilot: Autopilot, command: Command) -> Result:
    """Carry out a command; UNSUPPORTED for those the mock does not know."""
    action = ACTIONS.get(command.identifier)
    return Result.UNSUPPORTED if action is None else action(autopilot, command)


def _arm_disarm(autopilot: Autopilot, command: Command) -> Result:
    force = command.whole(2) == FORCE
    wanted = command.whole(1)
    if wanted not in (0, 1):
        return Result.UNSUPPORTED
    if wanted == 0:
        return autopilot.commander.disarm(command.time, force=force)
    return autopilot.arm(command.time, force=force)


def _set_mode(autopilot: Autopilot, command: Command) -> Result:
    mode = mode_from_command(command.whole(1), command.whole(2), command.whole(3))
    return autopilot.commander.set_mode(command.time, mode)


def _switch_to(mode: Mode) -> Callable[[Autopilot, Command], Result]:
    def switch(autopilot: Autopilot, command: Command) -> Result:
        return autopilot.commander.set_mode(command.time, mode)

    return switch


def _take_off(autopilot: Autopilot, command: Command) -> Result:
    altitude = command.parameters[6]
    autopilot.takeoff_altitude = altitude - ORIGIN_ALTITUDE if math.isfinite(altitude) and altitude > 0 else None
    return autopilot.commander.set_mode(command.time, Mode.TAKEOFF)


def _reposition(autopilot: Autopilot, command: Command) -> Result:
    result = autopilot.commander.set_mode(command.time, Mode.HOLD)
    if result is Result.ACCEPTED and autopilot.commander.armed and math.isfinite(command.parameters[6]):
        north, east = local_from_global(command.parameters[4], command.parameters[5])
        target = enu_from_ned([north, east, ORIGIN_ALTITUDE - command.parameters[6]])
        setpoint = ControlSetpoint("hold", position_world=target)
        autopilot.fly_to(autopilot.estimate_fault.meant(setpoint))
    return result


def _set_interval(_: Autopilot, command: Command) -> Result:
    accepted = command.link.streams.set_interval(command.time, command.whole(1), command.parameters[1])
    return Result.ACCEPTED if accepted else Result.FAILED


def _get_interval(_: Autopilot, command: Command) -> Result:
    identifier = command.whole(1)
    interval = command.link.streams.interval_us(identifier)
    message = mavlink.MAVLink_message_interval_message(identifier & 0xFFFF, interval)
    command.link.send(command.time, message)
    return Result.ACCEPTED


def _request_message(autopilot: Autopilot, command: Command) -> Result:
    return _send_once(autopilot, command, command.whole(1))


def _send_once(autopilot: Autopilot, command: Command, identifier: int) -> Result:
    if identifier not in telemetry.BUILDERS:
        return Result.DENIED
    for message in telemetry.build(identifier, autopilot.snapshot(command.time)):
        command.link.send(command.time, message)
    return Result.ACCEPTED


def _request(identifier: int) -> Callable[[Autopilot, Command], Result]:
    def send(autopilot: Autopilot, command: Command) -> Result:
        return _send_once(autopilot, command, identifier)

    return send


def _set_home(autopilot: Autopilot, _: Command) -> Result:
    autopilot.set_home()
    return Result.ACCEPTED


def _terminate(autopilot: Autopilot, command: Command) -> Result:
    if command.parameters[0] > 0.5:
        autopilot.commander.terminate()
    return Result.ACCEPTED


def _preflight_check(autopilot: Autopilot, command: Command) -> Result:
    if autopilot.commander.armed:
        return Result.TEMPORARILY_REJECTED
    return Result.ACCEPTED


def _reset_estimator(autopilot: Autopilot, command: Command) -> Result:
    numbers = [value if math.isfinite(value) else 0.0 for value in command.parameters[:4]]
    autopilot.estimate_fault.reset(enu_from_ned(numbers[:3]), -numbers[3])
    return Result.ACCEPTED


ACTIONS: dict[int, Callable[[Autopilot, Command], Result]] = {
    _M.MAV_CMD_COMPONENT_ARM_DISARM: _arm_disarm,
    _M.MAV_CMD_DO_SET_MODE: _set_mode,
    _M.MAV_CMD_NAV_TAKEOFF: _take_off,
    _M.MAV_CMD_NAV_LAND: _switch_to(Mode.LAND),
    _M.MAV_CMD_NAV_RETURN_TO_LAUNCH: _switch_to(Mode.RTL),
    _M.MAV_CMD_NAV_LOITER_UNLIM: _switch_to(Mode.HOLD),
    _M.MAV_CMD_DO_REPOSITION: _reposition,
    _M.MAV_CMD_DO_SET_HOME: _set_home,
    _M.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    _M.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    _M.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    _M.MAV_CMD_REQUEST_MESSAGE: _request_message,
    _M.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _request(_M.MAVLINK_MSG_ID_AUTOPILOT_VERSION),
    _M.MAV_CMD_REQUEST_PROTOCOL_VERSION: _request(ProtocolVersion.id),
    _M.MAV_CMD_GET_HOME_POSITION: _request(_M.MAVLINK_MSG_ID_HOME_POSITION),
    _M.MAV_CMD_RUN_PREARM_CHECKS: _preflight_check,
    _M.MAV_CMD_USER_1: _reset_estimator,  # the mock's own: what PX4's estimator does unasked
}
