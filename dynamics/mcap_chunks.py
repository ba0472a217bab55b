"""Chunks of MCAP files as their records, unpacked within the limits of all compressed files."""

from __future__ import annotations

from pathlib import Path

from mcap.records import Chunk, McapRecord
from mcap.stream_reader import breakup_chunk
from zstandard import ZstdError, frame_content_size

from dynamics.unpacking import Unpacking


def records_of(chunk: Chunk, path: Path) -> list[McapRecord]:
    """The records of a chunk of the file at a path.

    Raises RequestError for one that unpacks beyond the limits, before it does, and what mcap raises for a damaged one.
    """
    if chunk.compression != "zstd":
        return list(breakup_chunk(chunk))
    try:
        size = frame_content_size(chunk.data)  # for which the library makes room, whatever the chunk says; -1: unknown
    except ZstdError:
        size = 0
    size = chunk.uncompressed_size if size < 0 else size
    Unpacking(path, path.stat().st_size).add_bytes(size, len(chunk.data))
    return list(breakup_chunk(chunk))
