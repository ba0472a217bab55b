"""MAVLink tlogs of either or both directions: each frame behind its unix time in microseconds.

Payloads are collected per message and turned into arrays at the end, so that only what a flight needs is kept.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import development as mavlink
from pymavlink.generator.mavcrc import x25crc

from dynamics.autopilot import is_autopilot
from dynamics.recorded_vehicle import recorded_vehicle
from flights.assembly import Assembly
from flights.log import LogContent
from flights.readers import mavlink_streams
from flights.source import Source, TimeSpan

_TOKEN = re.compile(r"(\d*)([a-zA-Z])")
_STAMP = struct.Struct(">Q")
_V1, _V2 = 0xFE, 0xFD
_HEADERS = {_V1: 6, _V2: 10}
_SIGNED, _SIGNATURE_BYTES = 0x01, 13
_MAX_FRAME = 10 + 255 + 2 + _SIGNATURE_BYTES
_CHUNK_BYTES = 1 << 20
_LATEST_STAMP = 4_102_444_800_000_000  # microseconds: the year 2100


class Messages:
    """The payloads of one kind of message with their arrival: bytes while reading, then one structured array."""

    def __init__(self, number: int) -> None:
        kind = mavlink.mavlink_map.get(number)
        self.dtype = mavlink_streams.ESC_STATUS if kind is None else wire_dtype(kind)
        self.extra: int = mavlink_streams.ESC_STATUS_EXTRA if kind is None else kind.crc_extra
        self.arrivals = bytearray()
        self.payloads = bytearray()

    def add(self, arrival: int, payload: bytes) -> None:
        """Add a payload, with the trailing zeros that MAVLink 2 omits. arrival: unix time, microseconds."""
        size = self.dtype.itemsize
        self.arrivals += arrival.to_bytes(8, "little")
        self.payloads += payload[:size].ljust(size, b"\0")

    @property
    def arrival(self) -> NDArray[np.int64]:
        """(n,) unix time, microseconds."""
        return np.frombuffer(bytes(self.arrivals), dtype="<i8")

    @property
    def table(self) -> NDArray[np.void]:
        """(n,) fields by name."""
        return np.frombuffer(bytes(self.payloads), dtype=self.dtype)


def wire_dtype(kind: type[Any]) -> np.dtype[np.void]:
    """The wire format of a message's payload. kind: one of pymavlink's generated message classes."""
    layout = kind.unpacker.format
    tokens = _TOKEN.findall(layout.decode() if isinstance(layout, bytes) else layout)
    return np.dtype([_field(*field) for field in zip(kind.ordered_fieldnames, tokens, strict=True)])


def _field(name: str, token: tuple[str, str]) -> tuple[Any, ...]:
    count, letter = token
    base = np.dtype(letter).newbyteorder("<").str
    return (name, base, (int(count),)) if count else (name, base)


def matches(source: Source) -> bool:
    """Whether it begins with a time stamp of this century and a MAVLink frame."""
    head = source.head
    if len(head) < _STAMP.size + 8 or head[_STAMP.size] not in _HEADERS:
        return False
    return bool(0 < _STAMP.unpack_from(head)[0] < _LATEST_STAMP)


def read(source: Source) -> LogContent:
    """The streams of a tlog. Raises DataError when its time stamps cannot be those of one recording."""
    assembly = Assembly()
    collected: dict[tuple[int, int], dict[int, Messages]] = {}
    autopilots: list[tuple[int, int]] = []
    counts = {"frames": 0, "damaged": 0, "skipped": 0}
    with source.file.open("rb") as stream:
        for arrival, frame in _spanned(stream, counts, source.span):
            counts["frames"] += 1
            sender, number = _address(frame)
            if number not in mavlink_streams.NUMBERS:
                continue
            messages = collected.setdefault(sender, {}).setdefault(number, Messages(number))
            header = _HEADERS[frame[0]]
            payload = frame[header : header + frame[1]]
            if not _is_whole(frame, header, messages.extra):
                counts["damaged"] += 1
                continue
            messages.add(arrival, payload)
            if (
                number == mavlink.MAVLINK_MSG_ID_HEARTBEAT
                and sender not in autopilots
                and _is_autopilot(sender, payload)
            ):
                autopilots.append(sender)
    _note_counts(assembly, counts)
    vehicle = _vehicle(source, collected, autopilots, assembly)
    chosen = {
        number: (messages.arrival, messages.table)
        for sender, kinds in collected.items()
        for number, messages in kinds.items()
        if messages.arrivals and sender == vehicle and number not in mavlink_streams.SENT_TO_VEHICLE
    }
    for number in mavlink_streams.SENT_TO_VEHICLE:
        senders = (kinds[number] for sender, kinds in collected.items() if sender != vehicle and number in kinds)
        sent = max((_addressed(each, vehicle) for each in senders), key=lambda rows: len(rows[0]), default=None)
        if sent is not None and len(sent[0]):
            chosen[number] = sent
    mavlink_streams.add_streams(assembly, chosen)
    return assembly.finish()


def _note_counts(assembly: Assembly, counts: dict[str, int]) -> None:
    if counts["damaged"]:
        assembly.repair("damaged_frames", f"{counts['damaged']} of {counts['frames']} frames fail their checksum")
    if counts["skipped"]:
        assembly.repair("skipped_bytes", f"{counts['skipped']} bytes between frames or of a torn last one skipped")


def _vehicle(
    source: Source,
    collected: dict[tuple[int, int], dict[int, Messages]],
    autopilots: list[tuple[int, int]],
    assembly: Assembly,
) -> tuple[int, int] | None:
    """The address of the vehicle that is read, with a note where there was a choice."""
    frames = {sender: sum(len(kind.arrivals) for kind in kinds.values()) for sender, kinds in collected.items()}
    if not frames:
        return None
    vehicle, note = recorded_vehicle(source.path, autopilots, frames)
    if note:
        assembly.note(note)
    return vehicle


def _addressed(messages: Messages, vehicle: tuple[int, int] | None) -> tuple[NDArray[np.int64], NDArray[np.void]]:
    """Arrivals and fields of the messages that one sender has addressed to a vehicle, or to all."""
    arrival, table = messages.arrival, messages.table
    rows = np.isin(table["target_system"], (0,) if vehicle is None else (0, vehicle[0]))
    return arrival[rows], table[rows]


def _spanned(stream: BinaryIO, counts: dict[str, int], span: TimeSpan | None) -> Iterator[tuple[int, bytes]]:
    """Arrival and bytes of each frame of a span."""
    if span is None:
        yield from ((arrival, frame) for _, arrival, frame in _frames(stream, counts))
        return
    stream.seek(span.place or 0)
    for place, arrival, frame in _frames(stream, counts):
        span.origin = float(arrival) if span.origin is None else span.origin
        elapsed = (arrival - int(span.origin)) * 1e-6
        if not span.more:
            span.place = place
        if span.holds(elapsed):
            yield arrival, frame
        elif span.is_past(elapsed):
            return


def _frames(stream: BinaryIO, counts: dict[str, int]) -> Iterator[tuple[int, int, bytes]]:
    """Place in the file, arrival and bytes of each frame; other bytes are skipped and counted."""
    buffer, position, ended, before = bytearray(), 0, False, stream.tell()
    while True:
        if len(buffer) - position < _STAMP.size + _MAX_FRAME and not ended:
            del buffer[:position]
            before += position
            position = 0
            chunk = stream.read(_CHUNK_BYTES)
            ended = not chunk
            buffer += chunk
        start = position + _STAMP.size
        if start + 3 > len(buffer):
            counts["skipped"] += len(buffer) - position
            return
        length = _length(buffer, start)
        if length is None or _STAMP.unpack_from(buffer, position)[0] >= _LATEST_STAMP:
            counts["skipped"] += 1
            position += 1
            continue
        if start + length > len(buffer):
            counts["skipped"] += len(buffer) - position
            return
        yield before + position, _STAMP.unpack_from(buffer, position)[0], bytes(buffer[start : start + length])
        position = start + length


def _length(buffer: bytearray, start: int) -> int | None:
    magic = buffer[start]
    if magic not in _HEADERS:
        return None
    if magic == _V1:
        return _HEADERS[_V1] + buffer[start + 1] + 2
    if buffer[start + 2] & ~_SIGNED:
        return None
    return _HEADERS[_V2] + buffer[start + 1] + 2 + (_SIGNATURE_BYTES if buffer[start + 2] & _SIGNED else 0)


def _address(frame: bytes) -> tuple[tuple[int, int], int]:
    """Sender and message number."""
    if frame[0] == _V2:
        return (frame[5], frame[6]), frame[7] | frame[8] << 8 | frame[9] << 16
    return (frame[3], frame[4]), frame[5]


def _is_whole(frame: bytes, header: int, extra: int) -> bool:
    end = header + frame[1]
    crc = x25crc(frame[1:end] + bytes((extra,))).crc
    return bool(crc == frame[end] | frame[end + 1] << 8)


def _is_autopilot(sender: tuple[int, int], payload: bytes) -> bool:
    heartbeat = payload.ljust(9, b"\0")  # u32 custom_mode, u8 type, u8 autopilot, ...
    return is_autopilot(sender[1], heartbeat[4], heartbeat[5])
