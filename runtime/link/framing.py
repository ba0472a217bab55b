"""MAVLink frames out of a stream of bytes, whatever else is in it; decoding them is pymavlink's."""

from __future__ import annotations

from runtime.link.dialect import Message, mavlink, x25crc

MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
_HEADER_V1, _HEADER_V2, _CHECKSUM = 6, 10, 2
_SIGNED = 0x01
_MIN_FRAME = _HEADER_V1 + _CHECKSUM
_DECODER = mavlink.MAVLink(None)  # keeps no state between calls of decode


class Frame:
    """One frame whose checksum holds, as far as its definition is known; decoded when somebody asks for it.

    data: all its bytes. message_id: MAVLink's number. is_known: whether there is a definition for it.
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
        """The payload as it travelled, without the zeros that MAVLink 2 leaves out at its end."""
        start = _HEADER_V2 if self.data[0] == MAGIC_V2 else _HEADER_V1
        return self.data[start : start + self.data[1]]

    @property
    def message(self) -> Message:
        """The decoded message; for an unknown id, pymavlink's message of type UNKNOWN_<id>."""
        if self._message is None:
            self._message = _DECODER.decode(bytearray(self.data))
        return self._message


class FrameParser:
    """Splits bytes into frames and finds the next frame again after anything that is none.

    pymavlink's own stream parser drops everything that a false start claims to span; this one goes back to the
    byte after it, so that no good frame is lost behind a bad one.
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
            # a whole frame at the start of a packet: what was pending was cut off and will never be completed
            frames = self._take(to_the_end=True)
        self._pending += data
        return frames + self._take(to_the_end=False)

    def _starts_with_frame(self, data: bytes) -> bool:
        frame = self._frame_at(bytearray(data), 0)[0] if data else None
        return frame is not None and frame.is_known

    def _take(self, *, to_the_end: bool) -> list[Frame]:
        """The frames among the pending bytes; to_the_end: one that is not complete counts as garbage."""
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
        """The frame that starts here and its length, or None and the bytes to skip (0: not all of it is there yet)."""
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
            return (frame, length) if _checksum_holds(frame) else (None, 1)
        if available > length and buffer[start + length] not in (MAGIC_V1, MAGIC_V2):
            return None, 1  # its checksum cannot be verified, and what follows says that it was no frame
        return frame, length


def frame_length(data: bytes | bytearray, start: int) -> int | None:
    """Bytes of the frame whose magic byte stands at start, or None when too little of it is there to say."""
    if len(data) - start < _MIN_FRAME:
        return None
    if data[start] == MAGIC_V1:
        return _HEADER_V1 + data[start + 1] + _CHECKSUM
    signature = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if data[start + 2] & _SIGNED else 0
    return int(_HEADER_V2 + data[start + 1] + _CHECKSUM + signature)


def _checksum_holds(frame: Frame) -> bool:
    end = (_HEADER_V2 if frame.data[0] == MAGIC_V2 else _HEADER_V1) + frame.data[1]
    crc = x25crc(frame.data[1:end] + bytes((mavlink.mavlink_map[frame.message_id].crc_extra,)))
    return bool(crc.crc == frame.data[end] | frame.data[end + 1] << 8)
