"""The peer: state of the vehicle from its messages, and the answers to them. The link without its socket."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

import msgspec

from dynamics.autopilot import first_vehicle, is_autopilot
from runtime.link import modes, telemetry
from runtime.link.clock import VehicleClock
from runtime.link.datagram import AnsweredEstimate
from runtime.link.dialect import MESSAGE_IDS, Message, mavlink
from runtime.link.estimate import EstimateCheck, EstimateLimits, EstimateMonitor, ResetStep, StateEstimate
from runtime.link.framing import Frame
from runtime.link.odometry import Odometry, read_odometry
from runtime.link.rates import RateMeter
from runtime.link.setpoint_echo import SETPOINTS, SetpointReport
from runtime.link.telemetry import BatterySample, LinkEvent, LinkSeverity, Telemetry, Text, VehicleStatus
from runtime.link.texts import TextAssembler
from runtime.link.unconfirmed_change import UnconfirmedChange

_EVENT_PERIOD = 1.0  # s until an event of the same name is published again
MAX_STAMP_AGE = 10.0  # s before arrival, beyond which a stamp is not of the synchronised clock
MAX_STAMP_AHEAD = 0.1  # s; PX4's own simulation steps its clock by up to 18 ms, and an exchange errs by less
_SETPOINT_IDS = frozenset(MESSAGE_IDS[name] for name in SETPOINTS)


class Reaction(msgspec.Struct):
    """The consequences of one message.

    estimate: a new one, if it is accepted.
    reset: what an estimator reset moved.
    telemetry: a new sample.
    answers: messages to send.
    events: of the link.
    texts: complete STATUSTEXTs.
    setpoint: that the autopilot reports to follow, or that another sender sends.
    """

    estimate: StateEstimate | None = None
    reset: ResetStep | None = None
    telemetry: Telemetry | None = None
    answers: list[Message] = []
    events: list[LinkEvent] = []
    texts: list[Text] = []
    setpoint: SetpointReport | None = None


class Peer:
    """The vehicle at the other end of the link, from its messages.

    Pure: no socket and no clock, so that it reads a recording as it reads a link.

    address: system and component of the vehicle, None before its first heartbeat.
    first_heartbeat: when it came, s on our clock.
    last_heard: s on our clock.
    heard: every sender by system and component.
    candidates: of them, those whose heartbeat is an autopilot's.
    clock: the vehicle's.
    estimates: their checks.
    rates: of its messages.
    latest: sample of each kind.
    odometry_frames: frame and child frame of the latest ODOMETRY.
    """

    def __init__(self, target_system: int | None = None, estimate_limits: EstimateLimits | None = None) -> None:
        """target_system: the vehicle's system id, None for the first autopilot heard."""
        self._target_system = target_system
        self.address: tuple[int, int] | None = None
        self._status = VehicleStatus()
        self._texts = TextAssembler()
        self._published: dict[str, tuple[float, int]] = {}
        self.last_heard = self.first_heartbeat = float("-inf")
        self.heard: dict[tuple[int, int], str] = {}
        self.candidates: dict[tuple[int, int], str] = {}
        self.clock = VehicleClock()
        self.estimates = EstimateMonitor(estimate_limits)
        self.rates = RateMeter()
        self.latest: dict[type[Telemetry], Telemetry] = {}
        self.odometry_frames: tuple[int, int] | None = None
        self._disarming, self._mode_change = UnconfirmedChange(), UnconfirmedChange()
        self._handlers: dict[str, Callable[[Message, float, Reaction], None]] = {
            "ATTITUDE_QUATERNION": self._handle_attitude,
            "LOCAL_POSITION_NED": self._handle_local_position,
            "HEARTBEAT": self._handle_heartbeat,
            "TIMESYNC": self._handle_timesync,
            "EXTENDED_SYS_STATE": self._handle_extended_state,
            "CURRENT_MODE": self._handle_current_mode,
            "STATUSTEXT": self._handle_text,
            "ATTITUDE_TARGET": self._handle_attitude_target,
        }

    @property
    def status(self) -> VehicleStatus:
        """The vehicle's identity and state, with the time it was last heard."""
        return msgspec.structs.replace(self._status, last_heard=self.last_heard)

    def handle(self, frame: Frame, received: float, answered: AnsweredEstimate | None = None) -> Reaction:
        """Handle a frame of any sender. received: its arrival, s on our monotonic clock.

        answered: the estimate of its datagram where a setpoint has answered that already: then it is the estimate.
        """
        reaction = Reaction()
        if not frame.is_known:
            return reaction  # without a definition not even its checksum can be verified
        if frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self._discover(frame.system, frame.component, frame.message, received, reaction)
        if (frame.system, frame.component) != self.address:
            self.heard.setdefault((frame.system, frame.component), "no heartbeat yet")
            if frame.message_id in _SETPOINT_IDS:
                reaction.setpoint = _overheard(frame, received)
            return reaction
        self.last_heard = received
        self.rates.handle(frame.message_id, received)
        if frame.message_id == mavlink.MAVLINK_MSG_ID_ODOMETRY:
            self._handle_odometry(read_odometry(frame.payload), received, reaction, answered)
        else:
            self._handle_message(frame.message, received, reaction)
        return reaction

    def _handle_message(self, message: Message, received: float, reaction: Reaction) -> None:
        handler = self._handlers.get(message.get_type())
        if handler is not None:
            handler(message, received, reaction)
            return
        sample = telemetry.decode_telemetry(message, received, self._time_of)
        if sample is not None:
            self._store(sample)
            reaction.telemetry = sample

    def limit_event(self, time: float, name: str, severity: LinkSeverity, text: str) -> list[LinkEvent]:
        """The event to publish; none less than a second after one of the same name."""
        published, repeats = self._published.get(name, (float("-inf"), 0))
        if time - published < _EVENT_PERIOD:
            self._published[name] = (published, repeats + 1)
            return []
        self._published[name] = (time, 0)
        return [LinkEvent(time, name, severity, text, repeats)]

    def _store(self, sample: Telemetry) -> None:
        self.latest[type(sample)] = sample
        if isinstance(sample, BatterySample) and sample.voltage > 0:
            self._status = msgspec.structs.replace(self._status, battery_voltage=sample.voltage)

    def _time_of(self, remote: float, received: float) -> float:
        return self._synchronised(remote, received)[0]

    def _synchronised(self, remote: float, received: float) -> tuple[float, bool]:
        """Our time of a vehicle stamp, s, not after its arrival, and whether it is from the vehicle's clock."""
        if self.clock.is_valid(received):
            time = self.clock.to_ours(remote)
            if time - MAX_STAMP_AHEAD < received < time + MAX_STAMP_AGE:
                return min(time, received), True
        return received, False

    def _stamp_is_ahead(self, message: str, remote: float, received: float, reaction: Reaction) -> bool:
        """Whether an estimate is stamped in the future: its age is not known, and none is made up for it."""
        if not self.clock.is_valid(received):
            return False
        lead = self.clock.to_ours(remote) - received
        if lead <= MAX_STAMP_AHEAD:
            return False
        text = (
            f"{message} is stamped {lead:.3f} s ahead of the vehicle's clock by TIMESYNC, at most 0 is possible: its "
            "age is unknown, it is not used. Look for a second autopilot with the same id, or restart the vehicle."
        )
        reaction.events += self.limit_event(received, "estimate_stamp_ahead", "warning", text)
        return True

    def _discover(self, system: int, component: int, message: Message, received: float, reaction: Reaction) -> None:
        kind = telemetry.enum_name("MAV_TYPE", message.type, "MAV_TYPE_")
        autopilot = telemetry.enum_name("MAV_AUTOPILOT", message.autopilot, "MAV_AUTOPILOT_")
        self.heard[system, component] = f"{kind}, {autopilot}"
        if not is_autopilot(component, message.type, message.autopilot):
            return
        self.candidates[system, component] = self.heard[system, component]
        if first_vehicle(((system, component),), self._target_system) is None:
            return
        if not self._status.is_known:
            self._status = VehicleStatus(system=system, component=component, autopilot=autopilot, kind=kind)
            self.address, self.first_heartbeat = (system, component), received
            text = f"Vehicle {system}, component {component}: {kind} with {autopilot}."
            reaction.events += self.limit_event(received, "vehicle_found", "info", text)
        elif (system, component) != self.address:
            text = f"Vehicle {system} is on this link as well; following {self._status.system} only."
            reaction.events += self.limit_event(received, "other_vehicle", "warning", text)

    def _handle_heartbeat(self, message: Message, received: float, reaction: Reaction) -> None:
        before = self._status
        reaction.texts += self._texts.expire(received)
        armed = self._believed_armed(bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED), received, reaction)
        status = telemetry.enum_name("MAV_STATE", message.system_status, "MAV_STATE_")
        self._status = msgspec.structs.replace(before, armed=armed, system_status=status, last_heartbeat=received)
        self._set_mode(message.custom_mode, received, reaction)
        if armed != before.armed:
            _add_arming_event(armed, received, reaction)
        if status != before.system_status and status in ("critical", "emergency", "flight_termination"):
            mode = modes.mode_name(*modes.split_custom_mode(message.custom_mode))
            text = f"The vehicle reports the state {status}, in mode {mode}."
            reaction.events.append(LinkEvent(received, "vehicle_critical", "error", text))

    def _believed_armed(self, reported: bool, received: float, reaction: Reaction) -> bool:
        if reported:
            self._disarming.contradict()
            return True
        return self._status.armed and not self._believes(self._disarming, "disarmed", received, reaction)

    def _believes(self, change: UnconfirmedChange, value: object, received: float, reaction: Reaction) -> bool:
        """Whether a change that ends the stream in the air has two witnesses; after the first a second is requested."""
        if change.reported(value, received) or self._status.landed == "on_ground":
            return True
        request = (mavlink.MAV_CMD_REQUEST_MESSAGE, 0, mavlink.MAVLINK_MSG_ID_HEARTBEAT, 0, 0, 0, 0, 0, 0)
        reaction.answers.append(mavlink.MAVLink_command_long_message(*(self.address or (0, 0)), *request))
        return False

    def _handle_current_mode(self, message: Message, received: float, reaction: Reaction) -> None:
        if message.custom_mode:
            self._set_mode(message.custom_mode, received, reaction)

    def _set_mode(self, custom_mode: int, received: float, reaction: Reaction) -> None:
        before = self._status.mode
        main, sub = modes.split_custom_mode(custom_mode)
        mode = modes.mode_name(main, sub)
        if mode == before:
            self._mode_change.contradict()
            return
        in_offboard = self._status.armed and before == modes.OFFBOARD
        if in_offboard and not self._believes(self._mode_change, mode, received, reaction):
            return
        self._status = msgspec.structs.replace(self._status, main_mode=main, sub_mode=sub, mode=mode)
        if before != "unknown":
            text = f"The vehicle's mode went from {before} to {mode}."
            reaction.events.append(LinkEvent(received, "mode_changed", "info", text))

    def _handle_extended_state(self, message: Message, received: float, reaction: Reaction) -> None:
        landed = telemetry.landed_state(message.landed_state)
        if landed != self._status.landed:
            self._status = msgspec.structs.replace(self._status, landed=landed)
            reaction.events.append(LinkEvent(received, "landed_state", "info", f"Landed state: {landed}."))
        if landed == "on_ground" and self._status.armed and self._disarming.is_pending("disarmed", received):
            self._status = msgspec.structs.replace(self._status, armed=False)
            _add_arming_event(False, received, reaction)

    def _handle_text(self, message: Message, received: float, reaction: Reaction) -> None:
        reaction.texts += self._texts.handle(message, received)

    def _handle_attitude_target(self, message: Message, received: float, reaction: Reaction) -> None:
        reaction.setpoint = SetpointReport(received, _rates_of(message), message.thrust)

    def _handle_timesync(self, message: Message, received: float, reaction: Reaction) -> None:
        if message.tc1 == 0:
            self.clock.handle_one_way(received, message.ts1 * 1e-9)
            answer = mavlink.MAVLink_timesync_message(round(received * 1e9), message.ts1)
            reaction.answers.append(answer)
            return
        sent = message.ts1 * 1e-9
        if not received - 5.0 < sent <= received:
            return  # an answer to another system's request, whose clock is not ours
        offset = self.clock.offset(received)
        match self.clock.handle(sent, received, message.tc1 * 1e-9):
            case "jumped":
                text = f"The vehicle's clock jumped by {self.clock.offset(received) - offset:.3f} s."
                reaction.events += self.limit_event(received, "clock_jumped", "warning", text)
            case "ran_backwards":
                text = f"The vehicle's clock ran backwards by {offset - self.clock.offset(received):.3f} s: a reboot?"
                reaction.events += self.limit_event(received, "clock_ran_backwards", "error", text)
                self.estimates.reset()

    def _handle_odometry(
        self, odometry: Odometry, received: float, reaction: Reaction, answered: AnsweredEstimate | None
    ) -> None:
        self.odometry_frames = (odometry.frame_id, odometry.child_frame_id)
        if answered is not None:
            numbers = answered.time, received, answered.state, answered.reset_counter
            self._take(
                self.estimates.adopt(StateEstimate(*numbers, True, "ODOMETRY"), answered.stamp), received, reaction
            )
            return
        if self._stamp_is_ahead("ODOMETRY", odometry.time, received, reaction):
            return
        time, synchronised = self._synchronised(odometry.time, received)
        self._take(self.estimates.handle_odometry(odometry, time, received, synchronised), received, reaction)

    def _handle_local_position(self, message: Message, received: float, reaction: Reaction) -> None:
        self.estimates.handle_local_position(message, self._time_of(message.time_boot_ms * 1e-3, received))

    def _handle_attitude(self, message: Message, received: float, reaction: Reaction) -> None:
        stamp = message.time_boot_ms * 1e-3
        time, synchronised = self._synchronised(stamp, received)
        check = self.estimates.handle_attitude(message, time, received, synchronised)
        if check is not None and not self._stamp_is_ahead("ATTITUDE_QUATERNION", stamp, received, reaction):
            self._take(check, received, reaction)

    def _take(self, check: EstimateCheck, received: float, reaction: Reaction) -> None:
        reaction.estimate, reaction.reset = check.estimate, check.step
        if check.event is not None:
            reaction.events += self.limit_event(received, check.event, "warning", check.text)


def _rates_of(message: Message) -> tuple[float, float, float]:
    """Body rates, FLU, rad/s; NaN of a message that has none."""
    roll, pitch, yaw = (getattr(message, f"body_{axis}_rate", nan) for axis in ("roll", "pitch", "yaw"))
    return roll, -pitch, -yaw


def _overheard(frame: Frame, received: float) -> SetpointReport:
    message, sender = frame.message, (frame.system, frame.component)
    thrust = getattr(message, "thrust", nan)
    return SetpointReport(received, _rates_of(message), thrust, sender, message.get_type())


def _add_arming_event(armed: bool, received: float, reaction: Reaction) -> None:
    name = "armed" if armed else "disarmed"
    reaction.events.append(LinkEvent(received, name, "info", f"The vehicle is {name}."))
