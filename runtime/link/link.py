"""The link to a vehicle: a thread around `Peer` that reads, answers, keeps time, and publishes the newest estimate."""

from __future__ import annotations

import contextlib
import itertools
import queue
import threading
import time
from collections.abc import Callable, Iterator
from math import isfinite
from types import TracebackType
from typing import Literal, Self, TypeVar

import msgspec

from dynamics.errors import AlulaError, VehicleError
from dynamics.signing_key import SigningKey
from runtime import realtime
from runtime.link.connection import Endpoint
from runtime.link.datagram import AnsweredEstimate, ReadingThread
from runtime.link.dialect import Message, mavlink
from runtime.link.estimate import ResetStep, StateEstimate
from runtime.link.framing import Frame, FrameParser
from runtime.link.line_noise import LineNoise
from runtime.link.peer import Peer, Reaction
from runtime.link.setpoint_message import rate_setpoint_message
from runtime.link.signing import ACCEPTED, MESSAGES_LINK, REFUSALS, SETPOINTS_LINK, Signing
from runtime.link.silence import explain_silence
from runtime.link.telemetry import LinkEvent, LinkSeverity, VehicleStatus
from runtime.link.texts import text_messages
from runtime.link.transport import Received, Transport, TransportLostError, UdpTransport, open_transport
from runtime.link.vehicle_link import ATTEMPTS
from runtime.link.vehicle_source import Address, VehicleSource

Direction = Literal["in", "out"]
Answer = TypeVar("Answer")
# a frame, when it came, s, monotonic, where from, and the estimate of its datagram where that was answered already
Arrival = tuple[Frame, float, Address | None, AnsweredEstimate | None]

_YIELD_TIME = 1e-4  # s that this thread leaves the interpreter to the control thread after a new estimate
_REOPEN_PERIOD = 0.5  # s
_MAX_BATCH = 32  # frames, and datagrams, read before the frames are handled
_OTHERS_PERIOD = 0.02  # s between datagrams from elsewhere than the vehicle's address, whatever a stranger sends
_SETUP_SIGNING = mavlink.MAVLINK_MSG_ID_SETUP_SIGNING  # carries a key: neither recorded nor passed on
CANDIDATES_TIME = 2.0  # s in which other vehicles on the link must be heard: two periods of HEARTBEAT


class LinkSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Our identity on the link, the vehicle's, and our periods, s.

    target_system: the vehicle's system id, None for the first autopilot heard.
    roaming: whether the vehicle may continue from another address after a silence.
    signing_key: under which all is signed and nothing unsigned accepted, None for neither.
    own_system: None for the vehicle's own, as a companion on board.
    own_component: MAVLink's component id.
    gcs_heartbeat: whether to send a ground station's heartbeat, without which PX4 sends no STATUSTEXT; one that stops
        is a loss of the ground station.
    heartbeat_period: of our heartbeat.
    timesync_period: of our TIMESYNC requests.
    silence: without a message after which the vehicle counts as silent.
    priority: of SCHED_FIFO for the link's thread, because no setpoint is earlier than its estimate; None for none.
    """

    target_system: int | None = None
    roaming: bool = False
    signing_key: SigningKey | None = None
    own_system: int | None = None
    own_component: int = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
    gcs_heartbeat: bool = False
    heartbeat_period: float = 1.0
    timesync_period: float = 0.1
    silence: float = 1.0
    priority: int | None = None


class LinkCallbacks(msgspec.Struct, frozen=True):
    """Functions that the link calls, from its own and from the senders' threads; they must return quickly.

    frame: for every raw frame, with its direction and our monotonic time, s.
    message: for every decoded message, with its time of arrival.
    reset: for an estimator reset, before the estimate after it is published.
    reaction: for every message of the vehicle.
    event: for every event of the link.
    """

    frame: Callable[[Direction, float, bytes], None] | None = None
    message: Callable[[Message, float], None] | None = None
    reset: Callable[[ResetStep], None] | None = None
    reaction: Callable[[Reaction], None] | None = None
    event: Callable[[LinkEvent], None] | None = None


class Link:
    """A running link to one vehicle; `with Link(endpoint) as link:` opens it and closes it.

    Raises VehicleError or RequestError when the endpoint cannot be opened. An open link never raises: a lost device is
    the event link_lost, and the device is opened again once it is back.

    peer: the vehicle, as far as it was heard.
    source: the address that the vehicle sends from.
    parser: of the incoming bytes.
    signing: of frames in both directions.
    """

    def __init__(
        self, endpoint: Endpoint, settings: LinkSettings | None = None, callbacks: LinkCallbacks | None = None
    ) -> None:
        self.endpoint = endpoint
        self.settings = settings or LinkSettings()
        self.peer = Peer(self.settings.target_system)
        self.source = VehicleSource(roaming=self.settings.roaming)
        self.parser = FrameParser()
        self._callbacks = callbacks or LinkCallbacks()
        self.signing = Signing(self.settings.signing_key)
        try:
            self._transport: Transport = open_transport(endpoint)
        except AlulaError:
            self.signing.close()
            raise
        self._sequence: Iterator[int] | ReadingThread = itertools.count()
        # two packers, so that the control thread shares no lock with anybody
        self._packer, self._setpoint_packer = mavlink.MAVLink(None), mavlink.MAVLink(None)
        self.signing.equip(self._packer, MESSAGES_LINK)
        self.signing.equip(self._setpoint_packer, SETPOINTS_LINK)
        self._send_lock = threading.Lock()
        self._estimate: StateEstimate | None = None
        self._answered: StateEstimate | None = None
        self._handled: Callable[[], None] = _nothing
        self._waiting: list[threading.Lock] = []
        self._vehicle_found = threading.Event()
        self._listeners: tuple[Callable[[Message], None], ...] = ()
        self._text_identities = itertools.count(1)
        self._next_heartbeat = self._next_timesync = self._next_other = float("-inf")
        self._fixes_at: float | None = None
        self._silent = self._signing_failed = False
        self._noise = LineNoise(is_serial=endpoint.kind == "serial")
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop the thread and close the socket or device."""
        self._stop.set()
        if self._thread is not threading.current_thread():
            self._thread.join()
        self.signing.close()
        self._transport.close()

    @property
    def status(self) -> VehicleStatus:
        """The vehicle's identity and state."""
        return self.peer.status

    @property
    def transport(self) -> Transport:
        """The open socket or device."""
        return self._transport

    @property
    def own_system(self) -> int:
        """Our system id: the settings' one, else the vehicle's, else 1."""
        if self.settings.own_system is not None:
            return self.settings.own_system
        return self.peer.address[0] if self.peer.address is not None else self.settings.target_system or 1

    @property
    def own_component(self) -> int:
        """Our component id."""
        return self.settings.own_component

    def is_connected(self, now: float) -> bool:
        """Whether the vehicle was heard recently. now: s on our monotonic clock."""
        return now - self.peer.last_heard < self.settings.silence

    # --- a thread that answers estimates

    def read_by(self, start: Callable[[int, int], ReadingThread], handled: Callable[[], None]) -> ReadingThread | None:
        """Let a thread read the socket, which answers estimates before this link handles them. None without a socket
        that keeps to the vehicle.

        start: makes the thread, of a socket's descriptor and the next sequence number.
        handled: called by the link's thread once it has handled what came.
        """
        transport = self._transport
        if not isinstance(transport, UdpTransport) or transport.descriptor < 0:
            return None
        with self._send_lock:
            reader = start(transport.descriptor, next(self._sequence))
            self._sequence, self._handled = reader, handled
            transport.read_by(reader)
        return reader

    def take_answer(self, received: float, patience: float) -> StateEstimate | None:
        """The estimate that arrived then and was answered, once this link has handled it. received, patience: s."""
        deadline, newest = time.monotonic() + patience, self._estimate
        while self._answered is None or self._answered.received != received:
            if time.monotonic() >= deadline:
                return None
            newest = self.wait_for_estimate(newest, deadline)
        return self._answered

    def answered(self, timestamp: int, frame: bytes, departed: float) -> None:
        """Take over a setpoint that the thread has sent. timestamp: of its signature, -1 without one. departed: s."""
        if timestamp >= 0:
            self._setpoint_packer.signing.timestamp = timestamp + 1
        if self._callbacks.frame is not None:
            self._callbacks.frame("out", departed, frame)

    @property
    def setpoint_timestamp(self) -> int:
        """The newest timestamp of a signed setpoint."""
        return int(self._setpoint_packer.signing.timestamp) - 1

    # --- estimates

    @property
    def estimate(self) -> StateEstimate | None:
        """The newest accepted estimate."""
        return self._estimate

    def wait_for_estimate(self, newer_than: StateEstimate | None, deadline: float) -> StateEstimate | None:
        """The newest estimate as soon as it is not `newer_than`, or None at the deadline (s, monotonic)."""
        while True:
            # a lock per wait as in threading.Condition, whose Python code would take a tenth of the latency
            woken = threading.Lock()
            woken.acquire()
            self._waiting.append(woken)
            estimate, remaining = self._estimate, deadline - time.monotonic()
            if estimate is newer_than and remaining > 0 and woken.acquire(timeout=remaining):
                continue
            with contextlib.suppress(ValueError):
                self._waiting.remove(woken)
            return None if estimate is newer_than else estimate

    def wait_for_vehicle(self, timeout: float = 10.0) -> VehicleStatus:
        """The vehicle's status as soon as its heartbeat has come. timeout: s.

        Raises VehicleError after it, with a list of what was heard instead.
        """
        if not self._vehicle_found.wait(timeout):
            raise VehicleError(
                explain_silence(
                    self.endpoint,
                    timeout,
                    target_system=self.settings.target_system,
                    heard=self.peer.heard,
                    skipped_bytes=self.parser.skipped_bytes,
                    refusals=self.signing.explain_refusals(),
                )
            )
        return self.peer.status

    def require_one_vehicle(self) -> None:
        """Wait until any other vehicle on the link was heard, CANDIDATES_TIME from the first one's heartbeat on.

        Raises VehicleError if there are several and none was chosen by its system id.
        """
        if self.settings.target_system is not None:
            return
        self._stop.wait(max(0.0, self.peer.first_heartbeat + CANDIDATES_TIME - time.monotonic()))
        candidates = self.peer.candidates
        if len(candidates) > 1:
            listed = ", ".join(f"system {s}, component {c} ({what})" for (s, c), what in sorted(candidates.items()))
            raise VehicleError(
                f"{len(candidates)} vehicles are on {self.endpoint}: {listed}. Nothing was sent to fly. "
                f"Choose one: --system {min(candidates)[0]}, or give each its own port."
            )

    # --- sending

    def send(self, message: Message) -> bool:
        """Send a message under our ids, from any thread but the control thread. Returns whether the kernel took it."""
        with self._send_lock:
            return self._pack_and_send(self._packer, message, self.settings.own_component)

    def send_rate_setpoint(self, rate_body: tuple[float, float, float], thrust: float) -> bool:
        """Send SET_ATTITUDE_TARGET with body rates and thrust; shares no lock with other senders, for one thread only.

        rate_body: FLU, rad/s. thrust: 0..1, clipped. Returns whether it was sent: a value that is not finite is
        refused, because PX4 counts it as a sign of life (docs/px4.md).
        """
        if not (all(map(isfinite, rate_body)) and isfinite(thrust)):
            return False
        message = self.rate_setpoint(rate_body, thrust)
        return self._pack_and_send(self._setpoint_packer, message, self.settings.own_component)

    def rate_setpoint(self, rate_body: tuple[float, float, float], thrust: float) -> Message:
        """SET_ATTITUDE_TARGET with body rates, FLU, rad/s, and thrust, 0..1, clipped; all finite."""
        return rate_setpoint_message(self.peer.address or (0, 0), rate_body, thrust, time.monotonic())

    def send_text(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """Send a STATUSTEXT of any length."""
        for message in text_messages(text, severity, next(self._text_identities) & 0xFFFF or 1):
            self.send(message)

    def _pack_and_send(self, packer: Message, message: Message, component: int) -> bool:
        packer.srcSystem, packer.srcComponent = self.own_system, component
        packer.seq = next(self._sequence) & 0xFF
        self.signing.stamp(packer)
        data = message.pack(packer)
        sent = self._transport.send(data)
        if sent and self._callbacks.frame is not None and message.get_msgId() != _SETUP_SIGNING:
            self._callbacks.frame("out", time.monotonic(), data)
        return sent

    def send_signing_setup(self, key: SigningKey) -> None:
        """Send the vehicle a key for signing. Raises RequestError or VehicleError where that is not safe."""
        self.send(self.signing.setup_message(key, self.endpoint, self.status))

    # --- requests and answers

    @contextlib.contextmanager
    def listening(self, read: Callable[[Message], Answer | None]) -> Iterator[queue.SimpleQueue[Answer]]:
        """A queue of the results of `read` for the vehicle's messages, without None; it runs in the link's thread."""
        answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()

        def listen(message: Message) -> None:
            answer = read(message)
            if answer is not None:
                answers.put(answer)

        with self._send_lock:
            self._listeners = (*self._listeners, listen)
        try:
            yield answers
        finally:
            with self._send_lock:
                self._listeners = tuple(each for each in self._listeners if each is not listen)

    def exchange(
        self,
        request: Callable[[int], Message],
        read: Callable[[Message], Answer | None],
        *,
        timeout: float = 0.5,
        attempts: int = ATTEMPTS,
    ) -> Answer | None:
        """The first answer to a request that is repeated; None after all attempts.

        request: attempt number to message.
        read: message of the vehicle to answer, None if it is none.
        timeout: s for each attempt.
        """
        with self.listening(read) as answers:
            for attempt in range(attempts):
                self.send(request(attempt))
                try:
                    return answers.get(timeout=timeout)
                except queue.Empty:
                    continue
        return None

    # --- the thread

    def _run(self) -> None:
        if self.settings.priority is not None:
            for refusal in realtime.schedule_thread(self.settings.priority):
                text = f"The link's thread: {refusal}."
                self._publish_event(time.monotonic(), "realtime_unavailable", "warning", text)
        while not self._stop.is_set():
            self._send_due(time.monotonic())
            try:
                batch = self._receive()
            except TransportLostError as error:
                self._publish_event(time.monotonic(), "link_lost", "error", str(error))
                self._reopen()
                continue
            for arrival in batch:
                received = arrival[1]
                try:
                    self._handle(*arrival)
                except Exception as error:  # a defect of ours must not take the link down in flight
                    self._publish_event(received, "link_defect", "error", f"Handling a message failed: {error!r}")
            self._handled()
            self._hear_others(time.monotonic())

    def _receive(self) -> list[Arrival]:
        """The frames that have arrived, state estimates first: autopilots send in bursts, and the others can wait."""
        batch: list[Arrival] = []
        for number in range(_MAX_BATCH):  # of datagrams as well: a flood without a frame in it must not keep us here
            try:
                received = self._transport.receive(wait=number == 0)
            except TransportLostError:
                if number == 0:
                    raise
                break  # what came before the end is handled; the next call finds the end again
            if received is None:
                break
            batch += self._usable(self.parser, received)
            if len(batch) >= _MAX_BATCH:
                break
        if len(batch) > 1:
            batch.sort(key=lambda item: item[0].message_id != mavlink.MAVLINK_MSG_ID_ODOMETRY)
        return batch

    def _hear_others(self, now: float) -> None:
        """Handle a datagram from elsewhere than the vehicle's address, one in _OTHERS_PERIOD however many there are."""
        if now < self._next_other:
            return
        self._next_other = now + _OTHERS_PERIOD
        if self._fixes_at is not None and now >= self._fixes_at:
            self._fixes_at = None
            self._transport.keep_to_peer()
        received = self._transport.receive_other()
        if received is not None:
            for arrival in self._usable(FrameParser(), received):  # a stranger's half frame is in nobody's way
                self._handle(*arrival)

    def _usable(self, parser: FrameParser, received: Received) -> list[Arrival]:
        """The frames of received bytes that address and signature speak for, judged in the order of their arrival."""
        usable: list[Arrival] = []
        for frame in parser.feed(received.data):
            is_of_vehicle = (frame.system, frame.component) == self.peer.address
            if is_of_vehicle and not self.source.admits(received.source, received.time):
                self._reject_stranger(received.time, received.source)
            elif self._has_accepted_signature(frame, received.time, received.source):
                usable.append((frame, received.time, received.source, received.answered))
        return usable

    def _handle(self, frame: Frame, received: float, source: Address | None, answered: AnsweredEstimate | None) -> None:
        if (frame.system, frame.component) == self.peer.address:
            if not self.source.admits(source, received):  # the address was fixed by the frame before
                self._reject_stranger(received, source)
                return
            self.source.accept(source, received)
            self._transport.set_peer(source)
        if frame.message_id == _SETUP_SIGNING:
            return
        reaction = self.peer.handle(frame, received, answered)
        if reaction.reset is not None and self._callbacks.reset is not None:
            self._callbacks.reset(reaction.reset)
        if reaction.estimate is not None:
            if answered is not None:
                self._answered = reaction.estimate
            self._publish_estimate(reaction.estimate)
        if (frame.system, frame.component) == self.peer.address:
            if not self._vehicle_found.is_set():
                self.source.accept(source, received)
                self._transport.set_peer(source)
                self._fixes_at = received + CANDIDATES_TIME  # until then other vehicles must be heard
                self._vehicle_found.set()
                self._next_heartbeat = float("-inf")  # before, there was no address to send one to
            for answer in reaction.answers:
                self.send(answer)
            for listener in self._listeners:
                listener(frame.message)
        self._call_back(frame, received, reaction)

    def _reject_stranger(self, received: float, source: Address | None) -> None:
        """Count a frame with the vehicle's ids from elsewhere; the first is reported."""
        self.source.reject(source)
        if self.source.rejected == 1 and self.source.address is not None:
            host, port = (source or ("?", 0))[:2]
            text = (
                f"{host}:{port} sends with the ids of vehicle {self.peer.address}, which is heard from "
                f"{self.source.address[0]}:{self.source.address[1]}; it is not followed."
            )
            self._publish_event(received, "stranger_on_link", "warning", text)

    def _has_accepted_signature(self, frame: Frame, received: float, source: Address | None) -> bool:
        """Whether a frame may be used as far as its signature says; the first refusal of a kind is reported."""
        verdict = self.signing.judge(frame, self.peer.address)
        if verdict in ACCEPTED:
            return True
        if verdict in ("replayed", "outdated") and self.peer.address is None:
            # an autopilot without a clock continues from an old timestamp until it hears our heartbeat
            self._transport.set_peer(source)
        if self.signing.counts[verdict] == 1:
            text = f"A frame of {frame.system}/{frame.component} {REFUSALS[verdict]}; it is not used."
            self._publish_event(received, f"{verdict}_frame", "warning", text)
        return False

    def _publish_estimate(self, estimate: StateEstimate) -> None:
        self._estimate = estimate
        waiting, self._waiting = self._waiting, []
        for woken in waiting:
            woken.release()
        if waiting:
            time.sleep(_YIELD_TIME)

    def _call_back(self, frame: Frame, received: float, reaction: Reaction) -> None:
        if self._callbacks.frame is not None:
            self._callbacks.frame("in", received, frame.data)
        if self._callbacks.message is not None and frame.is_known:
            self._callbacks.message(frame.message, received)
        if self._callbacks.reaction is not None:
            self._callbacks.reaction(reaction)
        if self._callbacks.event is not None:
            for event in reaction.events:
                self._callbacks.event(event)

    def _publish_event(self, now: float, name: str, severity: LinkSeverity, text: str) -> None:
        if self._callbacks.event is not None:
            for event in self.peer.limit_event(now, name, severity, text):
                self._callbacks.event(event)

    def _send_due(self, now: float) -> None:
        """Send what is due, and publish when the vehicle falls silent or is heard again."""
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + self.settings.heartbeat_period
            self._send_heartbeats()
        if now >= self._next_timesync and self.peer.address is not None:
            self._next_timesync = now + self.settings.timesync_period
            self.send(mavlink.MAVLink_timesync_message(0, time.monotonic_ns()))
        if self.signing.clock is not None and self.signing.clock.failure and not self._signing_failed:
            self._signing_failed = True
            text = f"After a crash, timestamps of signing may repeat: {self.signing.clock.failure}"
            self._publish_event(now, "signing_unsaved", "warning", text)
        if self.peer.address is not None and (text := self._noise.check(now, self.parser.skipped_bytes)):
            self._publish_event(now, "bytes_lost", "warning", text)
        silent = self.peer.address is not None and not self.is_connected(now)
        if silent != self._silent:
            self._silent = silent
            if silent:
                text = f"The vehicle has been silent for {self.settings.silence:g} s."
                self._publish_event(now, "vehicle_silent", "error", text)
            else:
                self._publish_event(now, "vehicle_heard_again", "info", "The vehicle is heard again.")

    def _send_heartbeats(self) -> None:
        active, no_autopilot = mavlink.MAV_STATE_ACTIVE, mavlink.MAV_AUTOPILOT_INVALID
        self.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, no_autopilot, 0, 0, active, 3))
        if self.settings.gcs_heartbeat:
            message = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, no_autopilot, 0, 0, active, 3)
            with self._send_lock:
                self._pack_and_send(self._packer, message, mavlink.MAV_COMP_ID_MISSIONPLANNER)

    def _reopen(self) -> None:
        """Wait for a lost device or stream to come back."""
        self._transport.close()
        while not self._stop.wait(_REOPEN_PERIOD):
            try:
                self._transport = open_transport(self.endpoint)
            except AlulaError:
                continue
            self.parser = FrameParser()
            self._noise.restart()
            self._publish_event(time.monotonic(), "link_restored", "warning", f"{self.endpoint} is open again.")
            return


def _nothing() -> None:
    """Nobody waits for what was handled."""
