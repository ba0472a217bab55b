"""The flight recorder: an MCAP file and the link's raw .tlog, written by a separate thread.

The control thread only appends to a bounded ring. The writer drains it ten times a second and closes the MCAP chunk
at least twice a second, so that a killed process loses less than a second. A full disk ends the recording, not the
flight: what was written remains, and `trouble` is the reason.

Messages are JSON with a JSON schema: the one self-describing encoding that Foxglove and PlotJuggler both read without
plug-ins or message definitions. zstd removes its redundancy.
"""

from __future__ import annotations

import contextlib
import json
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

from mcap.writer import CompressionType, Writer

from runtime.record import foxglove, records
from runtime.record.records import EstimateRecord, HorizonRecord, Record, ReferenceRecord

RING_CAPACITY = 20_000  # records and frames; 10 s of a 200 Hz flight with every stream on
DRAIN_PERIOD = 0.1  # s
FLUSH_PERIOD = 0.4  # s; a process killed by kill -9 loses well below one second
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


class Recorder:
    """Takes records and frames from any thread without blocking, and writes them in a thread of its own.

    path: of the MCAP file.
    dropped: records and frames for which the ring had no room.
    """

    def __init__(
        self,
        directory: Path,
        name: str,
        *,
        metadata: Mapping[str, str],
        attachments: Mapping[str, str] | None = None,
        capacity: int = RING_CAPACITY,
        opener: Opener = open_unbuffered,
        simulated_epoch: float | None = None,
    ) -> None:
        """Open `name`.mcap and `name`.tlog in a directory, which is created. Raises OSError if that fails.

        simulated_epoch: unix time at time 0 of a flight in simulated time, s; such a flight waits for its recording,
            which is written by its own thread and so always the same. None for the clock's time.
        """
        directory.mkdir(parents=True, exist_ok=True)
        self.path = directory / f"{name}.mcap"
        self.dropped = 0
        self._failure = ""
        self._capacity = capacity
        self._ring: deque[tuple[float, Record | bytes]] = deque()
        self._simulated = simulated_epoch is not None
        self._unix_offset = time.time() - time.monotonic() if simulated_epoch is None else simulated_epoch
        self._flushed = 0.0
        self._mcap_file = SafeFile(self.path, opener)
        self._tlog = SafeFile(self.path.with_suffix(".tlog"), opener)
        self._mcap = McapFile(self._mcap_file, metadata, attachments or {})
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        if not self._simulated:
            self._thread.start()

    @property
    def trouble(self) -> str:
        """Why writing ended, or how much was dropped; empty while neither happened."""
        failure = self._failure or self._mcap_file.failure or self._tlog.failure
        return failure or (f"{self.dropped} records dropped" if self.dropped else "")

    @property
    def still_writing(self) -> bool:
        """Whether writing has not ended."""
        return not (self._failure or self._mcap_file.failure or self._tlog.failure)

    def put(self, record: Record, time_monotonic: float) -> None:
        """Pass a record to the writer; a full ring drops and counts it. Its arrays must not change later."""
        self._add(time_monotonic, record)

    def put_frame(self, frame: bytes, time_monotonic: float) -> None:
        """Pass a raw MAVLink frame of either direction to the .tlog."""
        self._add(time_monotonic, frame)

    def _add(self, time_monotonic: float, item: Record | bytes) -> None:
        if len(self._ring) >= self._capacity:
            self.dropped += 1
            return
        self._ring.append((time_monotonic, item))
        if self._simulated and time_monotonic - self._flushed >= FLUSH_PERIOD:
            self._flushed = time_monotonic
            self._drain()
            self._flush()

    def close(self) -> None:
        """Write what is pending and the index, and end the thread."""
        self._stopping.set()
        if self._simulated:
            self._run()
        else:
            self._thread.join()

    def _run(self) -> None:
        try:
            self._write()
        except Exception as error:  # recording must never end a flight, whatever is wrong with it
            self._failure = f"recorder stopped: {error!r}"
            self._ring.clear()
        finally:
            self._mcap_file.close()
            self._tlog.close()

    def _write(self) -> None:
        flushed = time.monotonic()
        while not self._stopping.wait(DRAIN_PERIOD):
            self._drain()
            if time.monotonic() - flushed >= FLUSH_PERIOD - DRAIN_PERIOD / 2:
                self._flush()
                flushed = time.monotonic()
        self._drain()
        self._mcap.finish()

    def _drain(self) -> None:
        # bounded by the length at the start, so that a flood cannot prevent flushing
        for _ in range(len(self._ring)):
            time_monotonic, item = self._ring.popleft()
            unix = round((time_monotonic + self._unix_offset) * 1e9)
            if isinstance(item, bytes):
                self._tlog.write(struct.pack(">Q", unix // 1000) + item)
            elif not self._mcap_file.failure:
                self._mcap.add(item, unix)

    def _flush(self) -> None:
        self._mcap.flush()
        self._tlog.flush()
