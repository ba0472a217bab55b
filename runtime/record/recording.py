"""Recordings, complete or cut off in flight, as NumPy columns for each topic."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Chunk, Footer, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray
from zstandard import ZstdError

from dynamics.decoding import decode_json
from dynamics.errors import DataError, RequestError
from dynamics.field_errors import described
from dynamics.mcap_chunks import records_of
from runtime.record.parts import parts_of
from runtime.record.records import LASTING, TOPICS, Record

MAGIC = b"\x89MCAP0\r\n"  # of an MCAP file
Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class FlightRecording:
    """The content of a recording.

    metadata: settings and versions, by name.
    attachments: texts by name, such as the vehicle file.
    messages: topic to rows as they were written.
    complete: whether the recorder closed the file.
    first_part: number of the part that it begins with, of a recording of bounded size; 1 where nothing is missing.
    """

    path: Path
    metadata: Mapping[str, str]
    attachments: Mapping[str, str]
    messages: Mapping[str, list[dict[str, Any]]]
    complete: bool
    first_part: int = 1

    def table(self, topic: str) -> dict[str, NDArray[Any]]:
        """One array for each field of a topic, rows along the first axis, null as NaN. Empty without records.

        Raises DataError for rows that differ in their fields.
        """
        rows = self.messages.get(topic, [])
        with damage_named(self.path):
            return {field: _column([row[field] for row in rows]) for field in (rows[0] if rows else {})}

    def records(self, kind: type[Record]) -> list[Any]:
        """A topic's rows as the structs that were recorded; a field that the recording lacks has its default.

        Raises DataError for rows that are none.
        """
        with damage_named(self.path):
            return [
                kind(**{field: _value(row[field]) for field in kind.__struct_fields__ if field in row})
                for row in self.messages.get(TOPICS[kind], [])
            ]


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Inside, what damaged bytes of a recording make its readers raise becomes a DataError that names the file."""
    try:
        yield
    except (msgspec.MsgspecError, LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        what = described(error).partition("\n")[0]
        raise DataError(
            f"{path} is damaged, or written by another alula: {type(error).__name__}: {what}. Give an intact copy, or "
            "`alula inspect` it for what can be read."
        ) from error


def _value(value: Any) -> Any:
    if value is None:
        return float("nan")
    return _column(value) if isinstance(value, list) else value


def _column(values: list[Any]) -> NDArray[Any]:
    if any(isinstance(value, str) for value in values):
        return np.array(values, dtype=object)
    if values and all(isinstance(value, bool) for value in values):
        return np.array(values, dtype=bool)
    if (widths := {len(value) for value in values if isinstance(value, list)}) and len(widths) > 1:
        values = [[*value, *[None] * (max(widths) - len(value))] for value in values]
    return np.array(values, dtype=float)  # None, JSON's null, becomes NaN


def _parts(path: Path) -> Iterator[McapRecord]:
    """Records of an MCAP file up to its end or to where it is cut off."""
    with path.open("rb") as stream:
        try:
            for part in StreamReader(stream, emit_chunks=True).records:
                yield from records_of(part, path) if isinstance(part, Chunk) else [part]
        except (McapError, struct.error, ValueError, OverflowError, MemoryError, ZstdError):
            return  # the last chunk is incomplete: the writer was killed or the disk was full


def newest_recording(path: Path) -> Path:
    """The recording itself, or of a folder the last by name: `alula fly` names recordings by date and time.

    Raises RequestError for a folder without recordings.
    """
    if not path.is_dir():
        return path
    recordings = sorted(path.glob("*.mcap"))
    if not recordings:
        raise RequestError(f"{path}: no recording there. Give a .mcap file of `alula fly --record`, or its folder.")
    return recordings[-1]


def read_attachments(path: Path) -> dict[str, str]:
    """The texts that a recording begins with, such as the vehicle file; empty for a file that is no recording."""
    attachments: dict[str, str] = {}
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                return {}
        for part in _parts(path):
            match part:
                case Message():
                    break  # the recorder writes them before the flight
                case Attachment():
                    attachments[part.name] = part.data.decode()
                case _:
                    pass
    except (OSError, UnicodeDecodeError):
        return {}
    return attachments


def read_recording(path: Path) -> FlightRecording:
    """Read a recording by scanning it, which needs no index; from one of several parts, all that are beside it.

    Raises RequestError for a path that cannot be read, DataError for a file that is no recording of `alula fly`.
    """
    with damage_named(path):
        if parts := parts_of(path):
            return _joined(path, parts)
        return _read(path)


def _joined(path: Path, parts: Mapping[int, Path]) -> FlightRecording:
    """The recording in parts, with the metadata and attachments of the one that was given; a part begins with rows of
    the part before (`LASTING`), which count once.
    """
    recording, newest = _read(path), max(parts)
    rows: dict[str, list[dict[str, Any]]] = {}
    complete, repeated = True, {TOPICS[kind] for kind in LASTING}
    for number, part in parts.items():
        try:
            read = recording if part == path else _read(part)
        except DataError:
            if number != newest:
                raise
            complete = False  # the writer was killed before it had written the settings
            continue
        complete = complete and read.complete
        for topic, added in read.messages.items():
            before = rows.setdefault(topic, [])
            before += [row for row in added if topic not in repeated or row not in before]
    return FlightRecording(path, recording.metadata, recording.attachments, rows, complete, min(parts))


def _read(path: Path) -> FlightRecording:
    topics: dict[int, str] = {}
    metadata: dict[str, str] = {}
    attachments: dict[str, str] = {}
    messages: dict[str, list[dict[str, Any]]] = {}
    complete = False
    try:
        for part in _parts(path):
            match part:
                case Channel():
                    topics[part.id] = part.topic
                case Message():
                    rows = messages.setdefault(topics[part.channel_id], [])
                    rows.append(decode_json(part.data))
                case Metadata() if part.name == "alula":
                    metadata.update(part.metadata)
                case Attachment():
                    attachments[part.name] = part.data.decode()
                case Footer():
                    complete = True
                case _:
                    pass
    except OSError as error:
        raise RequestError(f"cannot read {path}: {error.strerror}. Give a .mcap file that `alula fly` wrote.") from None
    if not metadata:
        raise DataError(f"{path} is no recording of `alula fly`. Give a .mcap file that `alula fly --record` wrote.")
    return FlightRecording(path, metadata, attachments, messages, complete)
