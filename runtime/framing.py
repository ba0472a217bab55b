"""MAVLink frames out of a stream of bytes, whatever else is in it; decoding is pymavlink's."""

from __future__ import annotations

import msgspec

from runtime.dialect import Message, mavlink

MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
_SIGNED = 0x01
_SHORTEST_FRAME = 8


class Frame(msgspec.Struct, frozen=True, gc=False):
    """One frame: its bytes, sender, id and decoded message (None when its id is in no definition)."""

    data: bytes
    system: int
    component: int
    message_id: int
    message: Message | None


class FrameParser:
    """Splits bytes into frames and finds the next frame again after anything that is none.

    pymavlink's own stream parser drops everything that a false start claims to span; this one goes back to the
    byte after it, so that no good frame is lost behind a bad one.
    """

    def __init__(self) -> None:
        self._pending = bytearray()
        self._decoder = mavlink.MAVLink(None)
        self.frames = 0
        self.unknown = 0
        self.skipped_bytes = 0

    def feed(self, data: bytes) -> list[Frame]:
        """The frames completed by these bytes, oldest first."""
        if self._pending and self._frame_at(bytearray(data), 0)[0] is not None:
            # a whole frame at the start of a packet: what was pending was cut off and will never be completed
            self.skipped_bytes += len(self._pending)
            self._pending.clear()
        self._pending += data
        frames: list[Frame] = []
        position, end = 0, len(self._pending)
        while position < end:
            frame, used = self._frame_at(self._pending, position)
            if frame is not None:
                frames.append(frame)
                self.frames += 1
                self.unknown += frame.message is None
            elif used:
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
        available = len(buffer) - start
        if available < _SHORTEST_FRAME:
            return None, 0
        header, trailer = 6, 2
        if magic == MAGIC_V2:
            header = 10
            if buffer[start + 2] & ~_SIGNED:
                return None, 1
            if buffer[start + 2] & _SIGNED:
                trailer += mavlink.MAVLINK_SIGNATURE_BLOCK_LEN
        length = header + buffer[start + 1] + trailer
        if available < length:
            return None, 0
        frame = self._decode(buffer[start : start + length], magic)
        if frame is None:
            return None, 1
        if frame.message is None and available > length and buffer[start + length] not in (MAGIC_V1, MAGIC_V2):
            return None, 1  # its checksum cannot be verified, and what follows says that it was no frame
        return frame, length

    def _decode(self, data: bytearray, magic: int) -> Frame | None:
        try:
            message = self._decoder.decode(data)
        except (mavlink.MAVError, ValueError, TypeError):
            return None
        system, component, number = data[3], data[4], data[5]
        if magic == MAGIC_V2:
            system, component = data[5], data[6]
            number = int.from_bytes(data[7:10], "little")
        known = not isinstance(message, mavlink.MAVLink_unknown)
        return Frame(bytes(data), system, component, number, message if known else None)
