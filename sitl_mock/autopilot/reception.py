"""Reception of each message that the mock knows; all others are ignored, as by PX4."""

from __future__ import annotations

import random
from collections.abc import Callable

from sitl_mock.autopilot.commander import Commander, Result
from sitl_mock.autopilot.commands import CommandHandler, command_of, is_addressed
from sitl_mock.autopilot.modes import mode_from_custom
from sitl_mock.autopilot.offboard import attitude_target, global_position_target, position_target
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.vehicle.clock import VehicleClock
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, Vehicle
from sitl_mock.wire.dialect import AUTOPILOT_COMPONENT, Message, mavlink
from sitl_mock.wire.estimate_fault import EstimateFault
from sitl_mock.wire.link import Link
from sitl_mock.wire.signing import AutopilotSigning

ACK_DELAY = (0.0005, 0.0145)  # s; measured 0.5 to 16 ms
SECOND_ACK_DELAY = (0.0, 0.007)
SECOND_VALUE_DELAY = (0.0145, 0.022)  # s; measured 14 to 23 ms
LIST_SPACING = 0.002  # s between two parameters of a list


class Reception:
    """Handles the messages that arrive on the links of an autopilot."""

    def __init__(
        self,
        vehicle: Vehicle,
        commander: Commander,
        parameters: Parameters,
        commands: CommandHandler,
        estimate_fault: EstimateFault,
        clock: VehicleClock,
        links: list[Link],
        signing: AutopilotSigning,
        *,
        double_ack: bool,
        source: random.Random,
    ):
        """double_ack: DO_SET_MODE is answered twice. source: random numbers for the delays of answers."""
        self._vehicle, self._commander, self._parameters = vehicle, commander, parameters
        self._commands, self._estimate_fault, self._clock = commands, estimate_fault, clock
        self._links, self._signing = links, signing
        self._system = int(parameters["MAV_SYS_ID"])
        self._double_ack = double_ack
        self._random = source

    def receive(self, link: Link, time: float, message: Message) -> None:
        """Handle one message that arrived on a link at a simulated time, s."""
        handler = HANDLERS.get(message.get_type())
        if handler is None or self._is_own(message):
            return
        try:
            handler(self, link, time, message)
        except (ValueError, OverflowError):
            link.bad_frames += 1  # a number that its field cannot hold

    def _is_own(self, message: Message) -> bool:
        return bool(message.get_srcSystem() == self._system and message.get_srcComponent() == AUTOPILOT_COMPONENT)

    def _is_addressed(self, message: Message) -> bool:
        return message.target_system in (0, self._system) and message.target_component in (0, AUTOPILOT_COMPONENT)

    def _heartbeat(self, link: Link, time: float, message: Message) -> None:
        link.note_heartbeat(time, message.type)

    def _timesync(self, link: Link, time: float, message: Message) -> None:
        if message.tc1 == 0:
            link.send(time, mavlink.MAVLink_timesync_message(self._clock.nanoseconds(time), message.ts1))

    def _ping(self, link: Link, time: float, message: Message) -> None:
        if message.target_system == 0 and message.target_component == 0:
            reply = mavlink.MAVLink_ping_message(message.time_usec, message.seq, *_sender(message))
            link.send(time, reply)

    def _attitude_target(self, _: Link, time: float, message: Message) -> None:
        if self._is_addressed(message):
            self._feed(time, attitude_target(message))

    def _position_target(self, _: Link, time: float, message: Message) -> None:
        if self._is_addressed(message):
            self._feed(time, position_target(message, self._vehicle.estimate.attitude))

    def _global_position_target(self, _: Link, time: float, message: Message) -> None:
        if self._is_addressed(message):
            self._feed(time, global_position_target(message))

    def _feed(self, time: float, setpoint: ControlSetpoint | None) -> None:
        if setpoint is not None:
            self._commander.offboard.feed(time, self._estimate_fault.to_plant_frame(setpoint))

    def _command(self, link: Link, time: float, message: Message) -> None:
        if not is_addressed(message, self._system):
            return
        result = self._commands.execute(command_of(message, time, link))
        self._acknowledge(link, time, message, message.command, result)

    def _set_mode(self, link: Link, time: float, message: Message) -> None:
        if message.target_system != self._system:
            return
        mode = mode_from_custom(message.base_mode, message.custom_mode)
        result = self._commander.set_mode(time, mode)
        self._acknowledge(link, time, message, mavlink.MAV_CMD_DO_SET_MODE, result)

    def _acknowledge(self, link: Link, time: float, message: Message, command: int, result: Result) -> None:
        sender = _sender(message)
        at = link.in_order(time + self._random.uniform(*ACK_DELAY))
        if self._double_ack and command == mavlink.MAV_CMD_DO_SET_MODE:
            link.send(at, mavlink.MAVLink_command_ack_message(command, Result.ACCEPTED, 0, 0, *sender))
            at = link.in_order(at + self._random.uniform(*SECOND_ACK_DELAY))
        link.send(at, mavlink.MAVLink_command_ack_message(command, result, 0, 0, *sender))

    def _parameter_list(self, link: Link, time: float, message: Message) -> None:
        if self._is_addressed(message) and link.may_list(time, len(self._parameters) * LIST_SPACING):
            for index, name in enumerate(self._parameters.names):
                link.send(time + index * LIST_SPACING, self._parameters.value_message(name))

    def _parameter_read(self, link: Link, time: float, message: Message) -> None:
        if self._is_addressed(message):
            link.send(time, self._parameters.read(_name(message), message.param_index, _sender(message)))

    def _parameter_set(self, link: Link, time: float, message: Message) -> None:
        if not self._is_addressed(message):
            return
        name = _name(message)
        answer, changed = self._parameters.set(name, message.param_value, message.param_type, _sender(message))
        link.send(time, answer)
        if changed:
            self._vehicle.tune(self._parameters.tuning())
            again = time + self._random.uniform(*SECOND_VALUE_DELAY)
            for other in self._links:
                other.send(again, self._parameters.value_message(name))

    def _setup_signing(self, _: Link, __: float, message: Message) -> None:
        if self._is_addressed(message) and not self._commander.armed:
            self._signing.handle_setup(message)

    def _mission_list(self, link: Link, time: float, message: Message) -> None:
        if self._is_addressed(message):
            kind = getattr(message, "mission_type", 0)
            link.send(time, mavlink.MAVLink_mission_count_message(*_sender(message), 0, kind))


def _sender(message: Message) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _name(message: Message) -> str:
    raw = message.param_id
    return raw if isinstance(raw, str) else bytes(raw).split(b"\0")[0].decode("ascii", "replace")


HANDLERS: dict[str, Callable[[Reception, Link, float, Message], None]] = {
    "HEARTBEAT": Reception._heartbeat,
    "TIMESYNC": Reception._timesync,
    "PING": Reception._ping,
    "SET_ATTITUDE_TARGET": Reception._attitude_target,
    "SET_POSITION_TARGET_LOCAL_NED": Reception._position_target,
    "SET_POSITION_TARGET_GLOBAL_INT": Reception._global_position_target,
    "COMMAND_LONG": Reception._command,
    "COMMAND_INT": Reception._command,
    "SET_MODE": Reception._set_mode,
    "PARAM_REQUEST_LIST": Reception._parameter_list,
    "PARAM_REQUEST_READ": Reception._parameter_read,
    "PARAM_SET": Reception._parameter_set,
    "SETUP_SIGNING": Reception._setup_signing,
    "MISSION_REQUEST_LIST": Reception._mission_list,
}
