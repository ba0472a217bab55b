"""MAVLink frames from a stream of bytes that may hold anything else; pymavlink decodes them."""

from __future__ import annotations

import re

from fastcrc.crc16 import mcrf4xx

from runtime.link.dialect import Message, mavlink

MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
_MAGIC = (MAGIC_V1, MAGIC_V2)
_HEADER = re.compile(rb"\xfe|\xfd(?:.[\x00\x01]|.?\Z)", re.DOTALL)  # of version 2 with flags that are defined
_MAX_PAYLOAD = 255
_HEADER_V1, _HEADER_V2, _CHECKSUM = 6, 10, 2
_SIGNED = 0x01
_MIN_FRAME = _HEADER_V1 + _CHECKSUM
_CHECKSUM_EXTRA = {number: bytes((kind.crc_extra,)) for number, kind in mavlink.mavlink_map.items()}
_SIZES = {number: kind.unpacker.size for number, kind in mavlink.mavlink_map.items()}  # of payloads
_DECODER = mavlink.MAVLink(None)  # keeps no state between calls of decode


class Frame:
    """One frame, decoded on first use; its checksum is right if its message is defined.

    data: all its bytes.
    system, component: the sender.
    message_id: MAVLink's number.
    is_known: whether its message is defined.
    """

    __slots__ = ("_message", "component", "data", "is_known", "message_id", "system")

    def __init__(self, data: bytes) -> None:
        self.data = data
        if data[0] == MAGIC_V2:
            self.system, self.component = data[5], data[6]
            self.message_id = data[7] | data[8] << 8 | data[9] << 16
        else:
            self.system, self.component, self.message_id = data[3], data[4], data[5]
        self.is_known = self.message_id in _CHECKSUM_EXTRA
        self._message: Message | None = None

    @property
    def is_signed(self) -> bool:
        """Whether it carries a signature, verified or not."""
        return self.data[0] == MAGIC_V2 and bool(self.data[2] & _SIGNED)

    @property
    def payload(self) -> bytes:
        """The payload as it was sent, without the trailing zeros that MAVLink 2 omits."""
        start = _HEADER_V2 if self.data[0] == MAGIC_V2 else _HEADER_V1
        return self.data[start : start + self.data[1]]

    @property
    def message(self) -> Message:
        """The decoded message; for an unknown id, pymavlink's message of type UNKNOWN_<id>."""
        if self._message is None:
            self._message = _DECODER.decode(bytearray(self.data))
        return self._message


class FrameParser:
    """Splits bytes into frames and finds the next frame after bytes that are none, in time linear in their number.

    pymavlink's own parser drops all bytes that a false start claims; this one continues behind its marker, so that
    no good frame is lost behind a bad one. The next marker is found by a search of its own; a place where a frame
    could start is checked once, from its header to its checksum, before anything is copied or decoded.

    frames: found so far.
    unknown: of those, without a definition.
    skipped_bytes: that belong to no frame.
    """

    def __init__(self) -> None:
        self._pending = b""
        self.frames = 0
        self.unknown = 0
        self.skipped_bytes = 0

    def feed(self, data: bytes) -> list[Frame]:
        """The frames completed by these bytes, oldest first."""
        frames: list[Frame] = []
        if self._pending and _starts_with_known_frame(data):
            # a frame at the start of a packet: the pending one was cut off and will never be completed
            frames = self._take(self._pending, cut_off=True)
        return frames + self._take(self._pending + data, cut_off=False)

    def _take(self, data: bytes, *, cut_off: bool) -> list[Frame]:
        """The frames among these bytes; an incomplete one at their end is pending, or skipped if it was cut off."""
        frames: list[Frame] = []
        position, end = 0, len(data)
        while position < end:
            length = _length_of_frame(data, position) if data[position] in _MAGIC else 0
            if length:
                frame = Frame(data[position : position + length])
                frames.append(frame)
                self.frames += 1
                self.unknown += not frame.is_known
                position += length
            elif length == 0 or cut_off:
                marker = _HEADER.search(data, position + 1)
                following = marker.start() if marker else end
                self.skipped_bytes += following - position
                position = following
            else:
                break
        self._pending = data[position:]
        return frames


def frame_length(data: bytes | bytearray, start: int) -> int | None:
    """Length in bytes of the frame that starts here, None if too few bytes are there to read it."""
    if len(data) - start < _MIN_FRAME:
        return None
    if data[start] == MAGIC_V1:
        return _HEADER_V1 + data[start + 1] + _CHECKSUM
    signature = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if data[start + 2] & _SIGNED else 0
    return int(_HEADER_V2 + data[start + 1] + _CHECKSUM + signature)


def _length_of_frame(data: bytes, start: int) -> int | None:
    """Length of the frame that starts at this marker: 0 if none does, None if it is incomplete yet."""
    length = frame_length(data, start)
    if length is None:
        return None
    if data[start] == MAGIC_V1:
        header, message_id = _HEADER_V1, data[start + 5]
        if data[start + 1] > _SIZES.get(message_id, _MAX_PAYLOAD):
            return 0  # version 1 knows no longer form of a message
    elif data[start + 2] & ~_SIGNED:
        return 0
    elif len(data) - start < _HEADER_V2:
        return None
    else:
        header, message_id = _HEADER_V2, data[start + 7] | data[start + 8] << 8 | data[start + 9] << 16
    if len(data) - start < length:
        return None
    extra = _CHECKSUM_EXTRA.get(message_id)
    if extra is None:  # its checksum cannot be verified: taken only where another frame or nothing follows it
        return length if start + length == len(data) or data[start + length] in _MAGIC else 0
    end = start + header + data[start + 1]
    return length if mcrf4xx(data[start + 1 : end] + extra) == data[end] | data[end + 1] << 8 else 0


def _starts_with_known_frame(data: bytes) -> bool:
    if not data or data[0] not in _MAGIC:
        return False
    length = _length_of_frame(data, 0)
    return bool(length) and Frame(data[:length]).is_known
