"""Reading .tlog files of ground stations and of our recorder: each frame after its unix time."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from dynamics.errors import DataError
from dynamics.unpacking import read_packed
from runtime.link.framing import MAGIC_V1, MAGIC_V2, Frame, FrameParser, frame_length

_STAMP = struct.Struct(">Q")  # microseconds since 1970, before each frame


def read_tlog(path: Path) -> Iterator[tuple[float, Frame]]:
    """The frames of a .tlog or .tlog.gz with their unix times, s, both directions in the order of the file.

    An incomplete last frame is omitted. Raises DataError for a file that is no tlog.
    """
    try:
        data = read_packed(path)
    except OSError as error:
        raise DataError(f"Cannot read {path}: {error.strerror or error}. Give a .tlog or .tlog.gz file.") from None
    position = 0
    while position + _STAMP.size < len(data):
        start = position + _STAMP.size
        if data[start] not in (MAGIC_V1, MAGIC_V2):
            raise DataError(f"{path} is no tlog: no MAVLink frame at byte {start}. Give a .tlog file.")
        length = frame_length(data, start)
        if length is None or start + length > len(data):
            return
        time = _STAMP.unpack_from(data, position)[0] * 1e-6
        for frame in FrameParser().feed(data[start : start + length]):
            yield time, frame
        position = start + length
