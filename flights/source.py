"""The file behind a log: opened, unpacked if it is gzipped, and hashed."""

from __future__ import annotations

import hashlib
import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import DataError, RequestError
from dynamics.unpacking import gunzip
from flights.log import Repair

HEAD_BYTES = 65_536
MAX_STEP_BACK = 0.5  # s; more is a clock that was set or a second recording in the same file
_CHUNK_BYTES = 1 << 20
_GZIP = b"\x1f\x8b"


@dataclass
class TimeSpan:
    """A span of a log that is larger than memory; a reader drops samples outside of it and updates it.

    start, end: s since the log's first sample; end excluded.
    origin: that sample's stamp on the file's own clock, None before it is read.
    place: where in the file the reader starts, and after reading where the next span starts, in the reader's own form;
        None for the file's start.
    following: the earliest sample at or after the end, s.
    """

    start: float
    end: float
    origin: float | None = None
    place: Any = None
    following: float = math.inf

    @property
    def more(self) -> bool:
        """Whether the log has samples at or after the end."""
        return math.isfinite(self.following)

    def holds(self, elapsed: float) -> bool:
        """Whether a sample belongs to it. elapsed: s since the log's first sample."""
        if elapsed >= self.end:
            self.following = min(self.following, elapsed)
        return self.start <= elapsed < self.end

    def mask(self, elapsed: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which samples belong to it. elapsed: (n,) s since the log's first sample."""
        late = elapsed[elapsed >= self.end]
        self.following = min(self.following, float(late.min(initial=math.inf)))
        return np.asarray((elapsed >= self.start) & (elapsed < self.end))

    def is_past(self, elapsed: float) -> bool:
        """Whether no further sample can belong to it; stamps may be out of order by MAX_STEP_BACK."""
        return elapsed >= self.end + MAX_STEP_BACK

    def next(self, seconds: float) -> TimeSpan:
        """The span of so many seconds that the next sample lies in."""
        start = max(self.end, math.floor(self.following / seconds) * seconds)
        end = max(start + seconds, math.nextafter(self.following, math.inf))
        return TimeSpan(start, end, self.origin, self.place)


@dataclass(frozen=True)
class Source:
    """A log to read.

    path: the user's.
    file: the same content unpacked, on disk.
    head: its first bytes.
    repairs: damage that unpacking left out.
    mapping: the user's column-mapping TOML.
    span: None for the whole log.
    """

    path: Path
    file: Path
    head: bytes
    repairs: tuple[Repair, ...] = ()
    mapping: Path | None = None
    span: TimeSpan | None = None

    @property
    def is_folder(self) -> bool:
        """Whether it is a folder, as bags of ROS 2 are."""
        return self.file.is_dir()

    def first_line(self) -> str:
        """The first line of a text file, empty for anything else."""
        line = self.head.split(b"\n", 1)[0]
        try:
            text = line.decode("utf-8-sig").strip()
        except UnicodeDecodeError:
            return ""
        return "" if "\0" in text else text


@contextmanager
def opened(path: Path, mapping: Path | None = None) -> Iterator[Source]:
    """The log at a path; a gzip is unpacked into a temporary file, so that it need not fit into memory.

    Raises RequestError when there is no such file, it cannot be read or is packed beyond the limits, DataError for an
    empty one.
    """
    try:
        if path.is_dir():
            yield Source(path, path, b"", mapping=mapping)
            return
        with path.open("rb") as stream:
            magic = stream.read(2)
        if not magic:
            raise DataError(f"{path} is empty. Wanted a flight log.")
        if magic != _GZIP:
            yield Source(path, path, _head(path), mapping=mapping)
            return
        with tempfile.TemporaryDirectory(prefix="alula-") as folder:
            file = Path(folder) / path.name.removesuffix(".gz")
            repairs = _unpack(path, file)
            if not file.stat().st_size:
                raise DataError(f"{path} is gzipped and empty. Wanted a flight log.")
            yield Source(path, file, _head(file), repairs, mapping)
    except OSError as error:
        raise RequestError(f"cannot read {path}: {error.strerror or error}. Give a flight log.") from error


def sha256(path: Path) -> str:
    """Hash of a file, or of the files of a folder in the order of their names."""
    digest = hashlib.sha256()
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    for file in files:
        with file.open("rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                digest.update(chunk)
    return digest.hexdigest()


def _head(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(HEAD_BYTES)


def _unpack(path: Path, file: Path) -> tuple[Repair, ...]:
    """Unpack up to a torn or damaged end, which becomes a repair. Raises RequestError beyond the limits."""
    with file.open("wb") as plain:
        error = gunzip(path, plain)
    if error is None:
        return ()
    return (Repair("torn_gzip", f"the gzip file ends early or is damaged ({error}); read up to there"),)
