"""MAVLink frames from a stream of bytes that may hold anything else; pymavlink decodes them."""

from __future__ import annotations

from runtime.link.dialect import Message, mavlink, x25crc

MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
_HEADER_V1, _HEADER_V2, _CHECKSUM = 6, 10, 2
_SIGNED = 0x01
_MIN_FRAME = _HEADER_V1 + _CHECKSUM
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
        self.is_known = self.message_id in mavlink.mavlink_map
        self._message: Message | None = None

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
    """Splits bytes into frames and finds the next frame after bytes that are none.

    pymavlink's own parser drops all bytes that a false start claims; this one continues at the byte after it, so
    that no good frame is lost behind a bad one.

    frames: found so far.
    unknown: of those, without a definition.
    skipped_bytes: that belong to no frame.
    """

    def __init__(self) -> None:
        self._pending = bytearray()
        self.frames = 0
        self.unknown = 0
        self.skipped_bytes = 0

    def feed(self, data: bytes) -> list[Frame]:
        """The frames completed by these bytes, oldest first."""
        frames: list[Frame] = []
        if self._pending and self._starts_with_frame(data):
            # a frame at the start of a packet: the pending one was cut off and will never be completed
            frames = self._take(to_the_end=True)
        self._pending += data
        return frames + self._take(to_the_end=False)

    def _starts_with_frame(self, data: bytes) -> bool:
        frame = self._frame_at(bytearray(data), 0)[0] if data else None
        return frame is not None and frame.is_known

    def _take(self, *, to_the_end: bool) -> list[Frame]:
        """The frames among the pending bytes. to_the_end: an incomplete one counts as skipped bytes."""
        frames: list[Frame] = []
        position, end = 0, len(self._pending)
        while position < end:
            frame, used = self._frame_at(self._pending, position)
            if frame is not None:
                frames.append(frame)
                self.frames += 1
                self.unknown += not frame.is_known
            elif used or to_the_end:
                used = used or 1
                self.skipped_bytes += used
            else:
                break
            position += used
        del self._pending[:position]
        return frames

    def _frame_at(self, buffer: bytearray, start: int) -> tuple[Frame | None, int]:
        """The frame that starts here and its length, or None and the bytes to skip (0: it is incomplete yet)."""
        magic = buffer[start]
        if magic not in (MAGIC_V1, MAGIC_V2):
            following = [at for at in (buffer.find(MAGIC_V2, start), buffer.find(MAGIC_V1, start)) if at >= 0]
            return None, (min(following) if following else len(buffer)) - start
        available, length = len(buffer) - start, frame_length(buffer, start)
        if length is None:
            return None, 0
        if magic == MAGIC_V2 and buffer[start + 2] & ~_SIGNED:
            return None, 1
        if available < length:
            return None, 0
        frame = Frame(bytes(buffer[start : start + length]))
        if frame.is_known:
            return (frame, length) if _checksum_is_right(frame) else (None, 1)
        if available > length and buffer[start + length] not in (MAGIC_V1, MAGIC_V2):
            return None, 1  # its checksum cannot be verified, and no frame follows it
        return frame, length


def frame_length(data: bytes | bytearray, start: int) -> int | None:
    """Length in bytes of the frame that starts here, None if too few bytes are there to read it."""
    if len(data) - start < _MIN_FRAME:
        return None
    if data[start] == MAGIC_V1:
        return _HEADER_V1 + data[start + 1] + _CHECKSUM
    signature = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if data[start + 2] & _SIGNED else 0
    return int(_HEADER_V2 + data[start + 1] + _CHECKSUM + signature)


def _checksum_is_right(frame: Frame) -> bool:
    end = (_HEADER_V2 if frame.data[0] == MAGIC_V2 else _HEADER_V1) + frame.data[1]
    crc = x25crc(frame.data[1:end] + bytes((mavlink.mavlink_map[frame.message_id].crc_extra,)))
    return bool(crc.crc == frame.data[end] | frame.data[end + 1] << 8)
