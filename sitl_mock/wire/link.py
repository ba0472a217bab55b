"""One MAVLink link: frames in from any number of peers, messages out when they are due, faults in between."""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Hashable
from dataclasses import dataclass, field

from sitl_mock.wire.dialect import AUTOPILOT_COMPONENT, Message, mavlink
from sitl_mock.wire.signing import REFUSED, AutopilotSigning, SignedParser
from sitl_mock.wire.streams import Role, Streams, loop_delay

GCS_TYPE = 6
GCS_TIMEOUT = 2.5  # s, PX4's HEARTBEAT_TIMEOUT
MARKERS = (0xFD, 0xFE)  # first bytes of a frame of MAVLink 2 and of MAVLink 1
MAX_PARSERS = 32
MAX_QUEUE = 20_000


@dataclass(slots=True)
class LinkFault:
    """Faults of the wire.

    loss: probability per frame, in both directions.
    duplication, reorder: probabilities per frame that the vehicle sends.
    down: nothing passes in either direction.
    jitter: longest delay of a frame that the vehicle sends, s; frames do not overtake each other.
    flood: DEBUG messages that the vehicle sends in addition, frames per second.
    """

    loss: float = 0.0
    duplication: float = 0.0
    reorder: float = 0.0
    down: bool = False
    flood: float = 0.0
    jitter: float = 0.0


@dataclass(order=True, slots=True)
class _Queued:
    time: float
    number: int
    message: Message = field(compare=False)
    frame: bytes | None = field(compare=False, default=None)


def _parsed(parser: Message, data: bytes) -> list[Message]:
    """All that a parser makes of bytes; after a false start it goes on at the byte behind its marker.

    pymavlink goes on behind all that the false start claims. That loses good frames, and it may do so for ever: the
    number of a command (510 is 0x01FE) holds a marker too, so that every next command is cut in two as well.
    """
    parsed = []
    message = parser.parse_char(data)
    while message is not None:
        parsed.append(message)
        if _is_false_start(message, parser.buf[parser.buf_index : parser.buf_index + 1]):
            parser.buf, parser.buf_index = message.get_msgbuf()[1:] + parser.buf[parser.buf_index :], 0
        message = parser.parse_char(b"")
    return parsed


def _is_false_start(message: Message, following: bytearray) -> bool:
    """Whether bytes with a marker are no frame: their checksum is wrong, or cannot be checked and no frame follows.

    following: the byte behind them, if there is one.
    """
    if message.get_type() == "BAD_DATA":
        return message.get_msgbuf()[0] in MARKERS and message.reason != REFUSED
    return "UNKNOWN" in message.get_type() and len(following) > 0 and following[0] not in MARKERS


class Link:
    """The mock's end of a link. All times are simulated seconds.

    fault: what the wire does to its frames.
    bad_frames: number of frames that were malformed, lost or held impossible numbers.
    punctual: leave out the jitter of PX4's mavlink loop, as lockstep needs.
    """

    def __init__(
        self,
        name: str,
        role: Role,
        system: int,
        sendable: frozenset[int],
        *,
        seed: int = 0,
        signing: AutopilotSigning | None = None,
    ):
        """signing: the autopilot's, None for an autopilot that cannot sign."""
        self.name = name
        self.streams = Streams(role, sendable, seed)
        self.fault = LinkFault()
        self.bad_frames = 0
        self.punctual = False
        self._random = random.Random(seed)
        self._packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=AUTOPILOT_COMPONENT)
        self._signing = mavlink.MAVLinkSigning() if signing is None else signing.add_link()
        self._packer.signing = self._signing
        self._parsers: dict[Hashable, Message] = {}
        self._queue: list[_Queued] = []
        self._number = 0
        self._loop_end = -math.inf
        self._answered = -math.inf
        self._listing_until = -math.inf
        self._last_gcs_heartbeat = -math.inf
        self._flood_due = 0.0
        self._delayed_until = -math.inf

    def parse(self, peer: Hashable, data: bytes) -> list[Message]:
        """The valid messages in bytes from a peer; whatever is malformed is counted and skipped."""
        parser = self._parsers.get(peer)
        if parser is None:
            if len(self._parsers) >= MAX_PARSERS:
                self._parsers.pop(next(iter(self._parsers)))
            parser = self._parsers[peer] = SignedParser(None)
            parser.robust_parsing, parser.signing = True, self._signing
        try:
            parsed = _parsed(parser, data)
        except Exception:  # pymavlink documents no exception and may raise any on hostile bytes; none may stop a link
            self._parsers.pop(peer, None)
            self.bad_frames += 1
            return []
        messages = [message for message in parsed if message.get_msgId() >= 0 and self._passes()]
        self.bad_frames += len(parsed) - len(messages)
        return [message for message in messages if "UNKNOWN" not in message.get_type()]

    def _passes(self) -> bool:
        return not self.fault.down and (self.fault.loss == 0.0 or self._random.random() >= self.fault.loss)

    def note_heartbeat(self, time: float, kind: int) -> None:
        """Note a heartbeat: a ground station's opens the link for texts."""
        if kind == GCS_TYPE:
            self._last_gcs_heartbeat = time

    def has_gcs(self, time: float) -> bool:
        """Whether a ground station's heartbeat arrived on this link within its timeout."""
        return time - self._last_gcs_heartbeat < GCS_TIMEOUT

    def send(self, time: float, message: Message, frame: bytes | None = None) -> None:
        """Queue a message (or a finished frame) to leave at a time."""
        if len(self._queue) < MAX_QUEUE:
            self._number += 1
            heapq.heappush(self._queue, _Queued(time, self._number, message, frame))

    def in_order(self, time: float) -> float:
        """When an answer that is due at a time leaves: never before the answer to an earlier command."""
        self._answered = max(self._answered, time)
        return self._answered

    def may_list(self, time: float, duration: float) -> bool:
        """Whether a list that takes a duration (s) may begin: one at a time, so that requests cannot fill the queue."""
        if time < self._listing_until:
            return False
        self._listing_until = time + duration
        return True

    def loop_time(self, time: float) -> float:
        """When the pass of the mavlink loop at a time puts its messages on the wire; passes never overtake."""
        if self.punctual:
            return time
        self._loop_end = max(self._loop_end, time + loop_delay(self._random))
        return self._loop_end

    @property
    def waiting(self) -> int:
        """How many messages wait to leave."""
        return len(self._queue)

    def next_departure(self) -> float:
        """When the next queued message leaves, infinity if none waits."""
        return self._queue[0].time if self._queue else math.inf

    def take(self, time: float) -> list[bytes]:
        """The frames that leave up to a time, in order, after the wire's faults."""
        frames: list[bytes] = []
        while self._queue and self._queue[0].time <= time:
            queued = heapq.heappop(self._queue)
            if queued.frame is not None:
                if not self.fault.down:  # its loss was drawn when it was put back
                    frames.append(queued.frame)
                continue
            frame = self._pack(queued.message)
            if frame is None or not self._passes():
                continue
            if self.fault.jitter:
                self._delayed_until = max(self._delayed_until, queued.time + self._random.uniform(0, self.fault.jitter))
                self.send(self._delayed_until, None, frame)
                continue
            if self.fault.reorder and self._random.random() < self.fault.reorder:
                self.send(queued.time + 0.012, None, frame)
                continue
            frames.append(frame)
            if self.fault.duplication and self._random.random() < self.fault.duplication:
                frames.append(frame)
        return frames

    def _pack(self, message: Message) -> bytes | None:
        try:
            frame = bytes(message.pack(self._packer))
        except (ValueError, OverflowError, mavlink.struct.error):
            return None  # a number that its field cannot hold, of a crashed or diverged vehicle
        self._packer.seq = (self._packer.seq + 1) % 256
        return frame

    def flood(self, time: float, duration: float) -> None:
        """Queue the DEBUG messages of the flood fault for a duration, s."""
        self._flood_due += self.fault.flood * duration if self.fault.flood else -self._flood_due
        while self._flood_due >= 1.0:
            self._flood_due -= 1.0
            self.send(time, mavlink.MAVLink_debug_message(0, 0, self._random.random()))
