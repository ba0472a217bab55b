"""A link to an autopilot in this process: MAVLink's bytes in both directions, in simulated time."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from typing import TypeVar

from dynamics.errors import VehicleError
from runtime.link.dialect import Message, mavlink
from runtime.link.estimate import StateEstimate
from runtime.link.framing import Frame, FrameParser
from runtime.link.link import LinkCallbacks, LinkSettings
from runtime.link.peer import Peer
from runtime.link.setpoint_message import rate_setpoint_message
from runtime.link.telemetry import VehicleStatus
from sitl_mock.autopilot.autopilot import Autopilot

Answer = TypeVar("Answer")

TRANSIT = 0.0002  # s from here to the autopilot, as over a local socket
COMPUTING = 0.002  # s from an estimate to the setpoint's departure, about what a tick takes on a companion computer
COMPANION = "companion"  # the peer's name at the autopilot's end


class LockstepLink:
    """The runtime's end of a link whose other end is simulated; to wait on it is to let simulated time pass.

    What arrives and what leaves are the frames of a real link, packed and parsed by the same code, in the order and at
    the times at which PX4's streams send them. Same inputs, same bytes.

    peer: the vehicle, as far as it was heard.
    estimate: the newest accepted one.
    now: simulated time, s.
    sent: time, s, body rates, FLU, rad/s, and thrust, 0..1, of the newest setpoint, sent or refused; None before it.
    """

    def __init__(self, autopilot: Autopilot, callbacks: LinkCallbacks) -> None:
        self.peer = Peer()
        self.estimate: StateEstimate | None = None
        self.now = autopilot.time
        self.sent: tuple[float, tuple[float, float, float], float] | None = None
        self._autopilot, self._callbacks = autopilot, callbacks
        self._wire = autopilot.add_link(COMPANION, "onboard")
        self._parser = FrameParser()
        self._packer = mavlink.MAVLink(None)
        self._settings = LinkSettings()
        self._sequence = 0
        self._listeners: list[Callable[[Message], None]] = []
        self._next_heartbeat = self._next_timesync = self.now

    @property
    def status(self) -> VehicleStatus:
        """The vehicle's identity and state."""
        return self.peer.status

    @property
    def own_system(self) -> int:
        """Our system id: the vehicle's, as of a companion on board."""
        return self.peer.address[0] if self.peer.address is not None else 1

    @property
    def own_component(self) -> int:
        """Our component id."""
        return self._settings.own_component

    def clock(self) -> float:
        """Simulated time, s."""
        return self.now

    def is_connected(self, now: float) -> bool:
        """Whether the vehicle was heard recently. now: s."""
        return now - self.peer.last_heard < self._settings.silence

    # --- simulated time

    def proceed(self, until: float) -> None:
        """Let time pass to the next arrival or to the end of the vehicle's next step, but not beyond a time, s."""
        arrival, step = self._wire.next_departure(), self._autopilot.next_step
        if min(arrival, step) > until:
            self.now = max(self.now, until)
        elif arrival <= step:
            self.now = max(self.now, arrival)
            self._receive(self._wire.take(arrival))
        else:
            self._autopilot.step()
            self.now = max(self.now, self._autopilot.time)
        self._send_due()

    def advance(self, duration: float) -> None:
        """Let a duration pass, s."""
        end = self.now + duration
        while self.now < end:
            self.proceed(end)

    def wait_for_estimate(self, newer_than: StateEstimate | None, deadline: float) -> StateEstimate | None:
        """The newest estimate as soon as it is not `newer_than`, or None at the deadline, s."""
        while self.estimate is newer_than and self.now < deadline:
            self.proceed(deadline)
        return None if self.estimate is newer_than else self.estimate

    def wait_for_vehicle(self, timeout: float) -> VehicleStatus:
        """The vehicle's status once its heartbeat has come. timeout: s. Raises VehicleError after it."""
        deadline = self.now + timeout
        while self.peer.address is None:
            if self.now >= deadline:
                raise VehicleError(f"the simulated vehicle sent no heartbeat within {timeout:g} s of simulated time.")
            self.proceed(deadline)
        return self.status

    # --- sending

    def send(self, message: Message) -> bool:
        """Send a message under our ids."""
        return self._pack_and_send(message, TRANSIT)

    def send_rate_setpoint(self, rate_body: tuple[float, float, float], thrust: float) -> bool:
        """Send SET_ATTITUDE_TARGET with body rates, FLU, rad/s, and thrust, 0..1; refuses what is not finite."""
        self.sent = (self.now, rate_body, thrust)
        if not (all(map(isfinite, rate_body)) and isfinite(thrust)):
            return False
        message = rate_setpoint_message(self.peer.address or (0, 0), rate_body, thrust, self.now)
        return self._pack_and_send(message, COMPUTING + TRANSIT)

    def _pack_and_send(self, message: Message, delay: float) -> bool:
        self._packer.srcSystem, self._packer.srcComponent = self.own_system, self.own_component
        self._packer.seq = self._sequence & 0xFF
        self._sequence += 1
        data = bytes(message.pack(self._packer))
        self._autopilot.receive(self._wire, COMPANION, data, self.now + delay)
        if self._callbacks.frame is not None:
            self._callbacks.frame("out", self.now, data)
        return True

    def exchange(
        self,
        request: Callable[[int], Message],
        read: Callable[[Message], Answer | None],
        *,
        timeout: float = 0.5,
        attempts: int = 4,
    ) -> Answer | None:
        """The first answer to a request that is repeated; None after all attempts. timeout: s for each attempt."""
        answers: list[Answer] = []

        def listen(message: Message) -> None:
            answer = read(message)
            if answer is not None:
                answers.append(answer)

        self._listeners.append(listen)
        try:
            for attempt in range(attempts):
                self.send(request(attempt))
                deadline = self.now + timeout
                while not answers and self.now < deadline:
                    self.proceed(deadline)
                if answers:
                    return answers[0]
        finally:
            self._listeners.remove(listen)
        return None

    def _send_due(self) -> None:
        if self.now >= self._next_heartbeat:
            self._next_heartbeat = self.now + self._settings.heartbeat_period
            active, no_autopilot = mavlink.MAV_STATE_ACTIVE, mavlink.MAV_AUTOPILOT_INVALID
            kind = mavlink.MAV_TYPE_ONBOARD_CONTROLLER
            self.send(mavlink.MAVLink_heartbeat_message(kind, no_autopilot, 0, 0, active, 3))
        if self.now >= self._next_timesync and self.peer.address is not None:
            self._next_timesync = self.now + self._settings.timesync_period
            self.send(mavlink.MAVLink_timesync_message(0, round(self.now * 1e9)))

    # --- receiving

    def _receive(self, frames: list[bytes]) -> None:
        """Handle what arrives now, state estimates first, as a link does."""
        arrived = [frame for data in frames for frame in self._parser.feed(data)]
        arrived.sort(key=lambda frame: frame.message_id != mavlink.MAVLINK_MSG_ID_ODOMETRY)
        for frame in arrived:
            self._handle(frame)

    def _handle(self, frame: Frame) -> None:
        callbacks = self._callbacks
        reaction = self.peer.handle(frame, self.now)
        if reaction.reset is not None and callbacks.reset is not None:
            callbacks.reset(reaction.reset)
        if reaction.estimate is not None:
            self.estimate = reaction.estimate
        for answer in reaction.answers:
            self.send(answer)
        for listener in tuple(self._listeners):
            listener(frame.message)
        if callbacks.frame is not None:
            callbacks.frame("in", self.now, frame.data)
        if callbacks.reaction is not None:
            callbacks.reaction(reaction)
        if callbacks.event is not None:
            for event in reaction.events:
                callbacks.event(event)
