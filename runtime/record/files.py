"""The files of a recording: an MCAP file and the link's raw .tlog beside it, which never raise once they are open."""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

from mcap.writer import CompressionType, Writer

from runtime.record import foxglove, records
from runtime.record.records import EstimateRecord, HorizonRecord, Record, ReferenceRecord

POSE_PERIOD = 0.04  # s between poses for the 3D view
_THINNED = (EstimateRecord, ReferenceRecord, HorizonRecord)

Opener = Callable[[Path], BinaryIO]


def open_unbuffered(path: Path) -> BinaryIO:
    """A new unbuffered file. Raises FileExistsError for an existing one."""
    return open(path, "xb", buffering=0)


class SafeFile:
    """A file that never raises: a failing disk ends it after the last complete write.

    failure: why it ended, empty while it has not.
    """

    def __init__(self, path: Path, opener: Opener = open_unbuffered) -> None:
        self.path = path
        self.failure = ""
        self._stream = opener(path)
        self._pending = bytearray()
        self._written = 0

    def write(self, data: bytes) -> int:
        """Add bytes, which `flush` writes to the disk."""
        if not self.failure:
            self._pending += data
        return len(data)

    def tell(self) -> int:
        """Number of bytes written and pending, as files call it."""
        return self._written + len(self._pending)

    def flush(self) -> None:
        """Write all pending bytes, or truncate the file to the last flush and set `failure`."""
        pending, self._pending = self._pending, bytearray()
        if self.failure or not pending:
            return
        try:
            view = memoryview(pending)
            while view:
                view = view[self._stream.write(view) or 0 :]
            self._written += len(pending)
        except OSError as error:
            self.failure = f"{self.path}: {error.strerror or error}"
            self._truncate()

    def _truncate(self) -> None:
        with contextlib.suppress(OSError):  # the reader copes with a torn last record
            self._stream.truncate(self._written)

    def close(self) -> None:
        """Flush and close, never raising."""
        self.flush()
        try:
            self._stream.close()
        except OSError as error:
            self.failure = self.failure or f"{self.path}: {error.strerror or error}"


class McapFile:
    """The MCAP file: a channel for each kind of record, opened with its first one."""

    def __init__(self, file: SafeFile, metadata: Mapping[str, str], attachments: Mapping[str, str]) -> None:
        self._writer = Writer(file, compression=CompressionType.ZSTD)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._last_view: dict[str, int] = {}
        self._writer.start(profile="", library="alula")
        self._writer.add_metadata("alula", dict(metadata))
        for name, text in attachments.items():
            self._writer.add_attachment(0, 0, name, "text/plain", text.encode())
        self.flush()

    def add(self, record: Record, unix: int) -> None:
        """Add a record, and its view for Foxglove if it has one. unix: nanoseconds."""
        topic = records.TOPICS[type(record)]
        kind = type(record)
        if topic not in self._channels:
            self._open(topic, f"alula.{kind.__name__}", json.dumps(records.schema_of(kind)))
        self._writer.add_message(self._channels[topic], unix, records.encode(record), unix)
        self._add_view(record, unix)

    def _add_view(self, record: Record, unix: int) -> None:
        topic = records.TOPICS[type(record)]
        if isinstance(record, _THINNED) and unix - self._last_view.get(topic, 0) < POSE_PERIOD * 1e9:
            return
        view = foxglove.view(record)
        if view is None:
            return
        self._last_view[topic] = unix
        name = foxglove.TOPICS[view[0]]
        if view[0] not in self._channels:
            self._open(view[0], name, json.dumps(foxglove.SCHEMAS[name]))
        self._writer.add_message(self._channels[view[0]], unix, foxglove.encode(view[1], unix), unix)

    def _open(self, topic: str, schema: str, text: str) -> None:
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", text.encode())
        self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[schema])

    def flush(self) -> None:
        """End the chunk and pass it to the operating system."""
        self._writer.flush()

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()


class RecordedFiles:
    """An MCAP file and the .tlog of the same name: a recording, or a part of one.

    path: of the MCAP file.
    """

    def __init__(
        self, path: Path, metadata: Mapping[str, str], attachments: Mapping[str, str], opener: Opener = open_unbuffered
    ) -> None:
        """Open both. Raises OSError where that fails."""
        self.path = path
        self._file = SafeFile(path, opener)
        try:
            self._tlog = SafeFile(path.with_suffix(".tlog"), opener)
        except OSError:
            self._file.close()
            raise
        self._mcap = McapFile(self._file, metadata, attachments)

    @property
    def failure(self) -> str:
        """Why writing ended, empty while it has not."""
        return self._file.failure or self._tlog.failure

    @property
    def size(self) -> int:
        """Bytes of both files."""
        return self._file.tell() + self._tlog.tell()

    def add(self, item: Record | bytes, unix: int) -> None:
        """Add a record, or a raw frame. unix: ns."""
        if isinstance(item, bytes):
            self._tlog.write(struct.pack(">Q", unix // 1000) + item)
        elif not self._file.failure:
            self._mcap.add(item, unix)

    def flush(self) -> None:
        """Pass what was added to the operating system."""
        self._mcap.flush()
        self._tlog.flush()

    def finish(self) -> None:
        """Write the index, and close."""
        self._mcap.finish()
        self.close()

    def close(self) -> None:
        """Close without an index."""
        self._file.close()
        self._tlog.close()

    def remove(self) -> None:
        """Remove both, which are closed. Raises OSError."""
        self.path.unlink(missing_ok=True)
        self.path.with_suffix(".tlog").unlink(missing_ok=True)
