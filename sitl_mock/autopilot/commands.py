"""MAVLink commands (COMMAND_LONG, COMMAND_INT): what PX4 does on each, and with which result it answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from sitl_mock.autopilot.commander import FORCE, Commander, Result
from sitl_mock.autopilot.modes import Mode, mode_from_command
from sitl_mock.autopilot.navigator import Navigator
from sitl_mock.autopilot.reporter import Reporter
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
from sitl_mock.wire import telemetry
from sitl_mock.wire.dialect import AUTOPILOT_COMPONENT, Message, ProtocolVersion, mavlink
from sitl_mock.wire.estimate_fault import EstimateFault
from sitl_mock.wire.link import Link
from sitl_mock.wire.snapshot import ORIGIN_ALTITUDE, local_from_global
from sitl_mock.wire.wire_axes import enu_from_ned

_M = mavlink
TO_ANY_COMPONENT = frozenset(
    {
        _M.MAV_CMD_REQUEST_MESSAGE,
        _M.MAV_CMD_REQUEST_PROTOCOL_VERSION,
        _M.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
    }
)

# commands that request one certain message
REQUESTS = {
    _M.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _M.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    _M.MAV_CMD_REQUEST_PROTOCOL_VERSION: ProtocolVersion.id,
    _M.MAV_CMD_GET_HOME_POSITION: _M.MAVLINK_MSG_ID_HOME_POSITION,
}


@dataclass(frozen=True, slots=True)
class Command:
    """A command as it arrived.

    identifier: MAV_CMD.
    parameters: the seven, latitude and longitude in 1e-7 degrees.
    time: of arrival, simulated, s.
    link: the link that it arrived on.
    """

    identifier: int
    parameters: tuple[float, ...]
    time: float
    link: Link

    def integer(self, number: int) -> int:
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


def is_addressed(message: Message, system: int) -> bool:
    """Whether a command is addressed to this autopilot."""
    if message.command in TO_ANY_COMPONENT:
        return message.target_system in (0, system)
    return message.target_system == system and message.target_component in (0, AUTOPILOT_COMPONENT)


class CommandHandler:
    """Carries out commands by the commander, the navigator, the estimator's frame and the link of the command."""

    def __init__(
        self, commander: Commander, navigator: Navigator, estimate_fault: EstimateFault, reporter: Reporter
    ) -> None:
        self._commander, self._navigator = commander, navigator
        self._estimate_fault, self._reporter = estimate_fault, reporter
        self._actions: dict[int, Callable[[Command], Result]] = {
            _M.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            _M.MAV_CMD_DO_SET_MODE: self._set_mode,
            _M.MAV_CMD_NAV_TAKEOFF: self._take_off,
            _M.MAV_CMD_NAV_LAND: lambda command: self._switch_to(Mode.LAND, command),
            _M.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda command: self._switch_to(Mode.RTL, command),
            _M.MAV_CMD_NAV_LOITER_UNLIM: lambda command: self._switch_to(Mode.HOLD, command),
            _M.MAV_CMD_DO_REPOSITION: self._reposition,
            _M.MAV_CMD_DO_SET_HOME: self._set_home,
            _M.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
            _M.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
            _M.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
            _M.MAV_CMD_REQUEST_MESSAGE: lambda command: self._send_once(command.integer(1), command),
            _M.MAV_CMD_RUN_PREARM_CHECKS: self._preflight_check,
            _M.MAV_CMD_USER_1: self._reset_estimator,  # the mock's own: what PX4's estimator does by itself
            **{command: self._request(message) for command, message in REQUESTS.items()},
        }

    def execute(self, command: Command) -> Result:
        """Carry out a command; UNSUPPORTED for those that the mock does not implement."""
        action = self._actions.get(command.identifier)
        return Result.UNSUPPORTED if action is None else action(command)

    def _arm_disarm(self, command: Command) -> Result:
        force = command.integer(2) == FORCE
        requested = command.integer(1)
        if requested not in (0, 1):
            return Result.UNSUPPORTED
        if requested == 0:
            return self._commander.disarm(command.time, force=force)
        return self._navigator.arm(command.time, force=force)

    def _set_mode(self, command: Command) -> Result:
        mode = mode_from_command(command.integer(1), command.integer(2), command.integer(3))
        return self._commander.set_mode(command.time, mode)

    def _switch_to(self, mode: Mode, command: Command) -> Result:
        return self._commander.set_mode(command.time, mode)

    def _take_off(self, command: Command) -> Result:
        altitude = command.parameters[6]
        is_set = math.isfinite(altitude) and altitude > 0
        self._navigator.takeoff_altitude = altitude - ORIGIN_ALTITUDE if is_set else None
        return self._commander.set_mode(command.time, Mode.TAKEOFF)

    def _reposition(self, command: Command) -> Result:
        result = self._commander.set_mode(command.time, Mode.HOLD)
        if result is Result.ACCEPTED and self._commander.armed and math.isfinite(command.parameters[6]):
            north, east = local_from_global(command.parameters[4], command.parameters[5])
            target = enu_from_ned([north, east, ORIGIN_ALTITUDE - command.parameters[6]])
            setpoint = ControlSetpoint("hold", position_world=target)
            self._navigator.hold_at(self._estimate_fault.to_plant_frame(setpoint))
        return result

    def _send_once(self, identifier: int, command: Command) -> Result:
        if identifier not in telemetry.BUILDERS:
            return Result.DENIED
        for message in telemetry.build(identifier, self._reporter.snapshot(command.time)):
            command.link.send(command.time, message)
        return Result.ACCEPTED

    def _request(self, identifier: int) -> Callable[[Command], Result]:
        return lambda command: self._send_once(identifier, command)

    def _set_home(self, _: Command) -> Result:
        self._navigator.set_home()
        return Result.ACCEPTED

    def _terminate(self, command: Command) -> Result:
        if command.parameters[0] > 0.5:
            self._commander.terminate()
        return Result.ACCEPTED

    def _preflight_check(self, _: Command) -> Result:
        return Result.TEMPORARILY_REJECTED if self._commander.armed else Result.ACCEPTED

    def _reset_estimator(self, command: Command) -> Result:
        numbers = [value if math.isfinite(value) else 0.0 for value in command.parameters[:4]]
        self._estimate_fault.reset(enu_from_ned(numbers[:3]), -numbers[3])
        return Result.ACCEPTED


def _set_interval(command: Command) -> Result:
    accepted = command.link.streams.set_interval(command.time, command.integer(1), command.parameters[1])
    return Result.ACCEPTED if accepted else Result.FAILED


def _get_interval(command: Command) -> Result:
    identifier = command.integer(1)
    interval = command.link.streams.interval_us(identifier)
    message = mavlink.MAVLink_message_interval_message(identifier & 0xFFFF, interval)
    command.link.send(command.time, message)
    return Result.ACCEPTED
