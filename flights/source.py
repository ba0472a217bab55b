"""The file behind a log: opened, unpacked if it is gzipped, and hashed."""

from __future__ import annotations

import gzip
import hashlib
import math
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.errors import DataError, RequestError
from flights.log import Repair

HEAD_BYTES = 65_536
MAX_STEP_BACK = 0.5  # s; more is a clock that was set or a second recording in the same file
_PIECE = 1 << 20
_GZIP = b"\x1f\x8b"


@dataclass
class Span:
    """A segment of a log that is larger than memory: what lies before start or from end on is not kept.

    start, end: s since the log's first sample. origin: that sample's stamp on the file's own clock, once it is known.
    place: where in the file its reader begins, and at last where the next segment begins, in a form of the reader's
    own; None for the beginning. following: the earliest sample seen at or after the end, s.
    """

    start: float
    end: float
    origin: float | None = None
    place: Any = None
    following: float = math.inf

    @property
    def more(self) -> bool:
        """Whether anything came at or after the end."""
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
        """Whether nothing of it comes any more, as far as stamps may be out of order."""
        return elapsed >= self.end + MAX_STEP_BACK

    def next(self, seconds: float) -> Span:
        """The segment of so many seconds that the next sample lies in."""
        start = max(self.end, math.floor(self.following / seconds) * seconds)
        end = max(start + seconds, math.nextafter(self.following, math.inf))
        return Span(start, end, self.origin, self.place)


@dataclass(frozen=True)
class Source:
    """A log to read. path: as it was given. file: the same content unpacked, on disk. head: its first bytes.

    repairs: what unpacking had to leave out. mapping: column-mapping TOML that the user gave. span: the segment to
    keep, everything if None.
    """

    path: Path
    file: Path
    head: bytes
    repairs: tuple[Repair, ...] = ()
    mapping: Path | None = None
    span: Span | None = None

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
    """The log at a path, its gzip unpacked into a temporary file so that nothing has to fit into memory.

    Raises RequestError when there is no such file or it cannot be read, DataError for an empty one.
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
                raise DataError(f"{path} is gzipped and holds nothing. Wanted a flight log.")
            yield Source(path, file, _head(file), repairs, mapping)
    except OSError as error:
        raise RequestError(f"cannot read {path}: {error.strerror or error}. Give a flight log.") from error


def sha256(path: Path) -> str:
    """Hash of a file, or of the files of a folder in the order of their names."""
    digest = hashlib.sha256()
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    for file in files:
        with file.open("rb") as stream:
            while piece := stream.read(_PIECE):
                digest.update(piece)
    return digest.hexdigest()


def _head(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(HEAD_BYTES)


def _unpack(path: Path, file: Path) -> tuple[Repair, ...]:
    """Unpack what can be unpacked; a torn or damaged end is left out and named."""
    with gzip.open(path, "rb") as packed, file.open("wb") as plain:
        try:
            while piece := packed.read1(_PIECE):  # read1 hands over what is whole before it meets the damage
                plain.write(piece)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            return (Repair("torn_gzip", f"the gzip file ends early or is damaged ({error}); read up to there"),)
    return ()
