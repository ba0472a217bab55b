"""Chunks of MCAP files as their records, unpacked within the limits of all compressed files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mcap.records import Chunk, McapRecord
from mcap.stream_reader import breakup_chunk

from dynamics.packed_chunks import METHODS, unpacked


def records_of(chunk: Chunk, path: Path) -> list[McapRecord]:
    """The records of a chunk of the file at a path.

    Raises RequestError for one that unpacks beyond the limits, while it does, and what mcap raises for a damaged one.
    """
    if chunk.compression in METHODS:
        chunk = replace(chunk, data=unpacked(chunk.data, chunk.compression, path), compression="")
    return list(breakup_chunk(chunk))
