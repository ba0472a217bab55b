"""The flight recorder: an MCAP file and the link's raw .tlog, written by a separate thread.

The control thread only appends to a bounded ring. The writer drains it ten times a second and closes the MCAP chunk
at least twice a second, so that a killed process loses less than a second. A full disk ends the recording, not the
flight: what was written remains, and `trouble` is the reason. With a limit the recording is written in parts, of which
the oldest goes (`parts.py`).

Messages are JSON with a JSON schema: the one self-describing encoding that Foxglove and PlotJuggler both read without
plug-ins or message definitions. zstd removes its redundancy.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path

from runtime.record.files import Opener, RecordedFiles, open_unbuffered
from runtime.record.parts import MAX_PARTS, PART, part_bytes, part_path
from runtime.record.records import LASTING, Record

RING_CAPACITY = 20_000  # records and frames; 10 s of a 200 Hz flight with every stream on
DRAIN_PERIOD = 0.1  # s
FLUSH_PERIOD = 0.4  # s; a process killed by kill -9 loses well below one second


class Recorder:
    """Takes records and frames from any thread without blocking, and writes them in a thread of its own.

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
        max_bytes: int | None = None,
    ) -> None:
        """Open `name`.mcap and `name`.tlog in a directory, which is created. Raises OSError if that fails.

        max_bytes: of all files of this recording, which is then written in parts; None for one that grows.
        simulated_epoch: unix time at time 0 of a flight in simulated time, s; such a flight waits for its recording,
            which is written by its own thread and so always the same. None for the clock's time.
        """
        directory.mkdir(parents=True, exist_ok=True)
        self.dropped = 0
        self._failure = ""
        self._capacity = capacity
        self._ring: deque[tuple[float, Record | bytes]] = deque()
        self._simulated = simulated_epoch is not None
        self._unix_offset = time.time() - time.monotonic() if simulated_epoch is None else simulated_epoch
        self._flushed = 0.0
        self._directory, self._name, self._opener, self._max_bytes = directory, name, opener, max_bytes
        self._metadata, self._attachments = metadata, attachments or {}
        self._part_number, self._finished = 1, deque[RecordedFiles]()
        self._lasting: dict[tuple[type[Record], str], tuple[int, Record]] = {}
        self._files = self._open()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        if not self._simulated:
            self._thread.start()

    def _open(self) -> RecordedFiles:
        """The files to write to next. Raises OSError."""
        if self._max_bytes is None:
            return RecordedFiles(
                self._directory / f"{self._name}.mcap", self._metadata, self._attachments, self._opener
            )
        path = part_path(self._directory, self._name, self._part_number)
        metadata = {**self._metadata, PART: str(self._part_number)}
        return RecordedFiles(path, metadata, self._attachments, self._opener)

    @property
    def path(self) -> Path:
        """The MCAP file that is written; of a recording in parts the newest."""
        return self._files.path

    @property
    def trouble(self) -> str:
        """Why writing ended, or how much was dropped; empty while neither happened."""
        failure = self._failure or self._files.failure
        return failure or (f"{self.dropped} records dropped" if self.dropped else "")

    @property
    def still_writing(self) -> bool:
        """Whether writing has not ended."""
        return not (self._failure or self._files.failure)

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
        except OSError as error:  # of a file that is not open yet
            self._failure = f"{error.filename or self.path}: {error.strerror or error}"
            self._ring.clear()
        except Exception as error:  # recording must never end a flight, whatever is wrong with it
            self._failure = f"recorder stopped: {error!r}"
            self._ring.clear()
        finally:
            self._files.close()

    def _write(self) -> None:
        flushed = time.monotonic()
        while not self._stopping.wait(DRAIN_PERIOD):
            self._drain()
            if time.monotonic() - flushed >= FLUSH_PERIOD - DRAIN_PERIOD / 2:
                self._flush()
                flushed = time.monotonic()
        self._drain()
        self._files.finish()

    def _drain(self) -> None:
        # bounded by the length at the start, so that a flood cannot prevent flushing
        for _ in range(len(self._ring)):
            time_monotonic, item = self._ring.popleft()
            unix = round((time_monotonic + self._unix_offset) * 1e9)
            self._files.add(item, unix)
            if isinstance(item, LASTING):
                self._lasting[type(item), getattr(item, "name", "")] = (unix, item)

    def _flush(self) -> None:
        self._files.flush()
        is_full = self._max_bytes is not None and self._files.size >= part_bytes(self._max_bytes)
        if is_full and not self._files.failure:
            self._begin_part()

    def _begin_part(self) -> None:
        """Finish the part that is full, remove the oldest, and begin one with the records that still hold.

        Raises OSError.
        """
        self._files.finish()
        self._finished.append(self._files)
        self._part_number += 1
        while len(self._finished) >= MAX_PARTS:
            self._finished.popleft().remove()
        self._files = self._open()
        for unix, record in self._lasting.values():
            self._files.add(record, unix)
