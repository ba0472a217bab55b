"""Limits on what a compressed file may become, checked while it is unpacked: files, bytes, and bytes over packed bytes.

The limits are of this process and its children, in the environment, so that every command and every reader has them:
ALULA_UNPACK_FILES, ALULA_UNPACK_GB and ALULA_UNPACK_RATIO.
"""

from __future__ import annotations

import gzip
import io
import math
import os
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from dynamics.errors import RequestError

FILES, BYTES, RATIO = "ALULA_UNPACK_FILES", "ALULA_UNPACK_GB", "ALULA_UNPACK_RATIO"
DEFAULTS = {FILES: 10_000.0, BYTES: 16.0, RATIO: 100.0}
FREE_BYTES = 64 << 20  # that are never too much, however small they were packed: zeros pack 1,000 to 1
CHUNK = 1 << 20  # bytes that are unpacked at once


def limit_of(name: str) -> float:
    """A limit by its variable's name. Raises RequestError for a variable that holds no positive number."""
    text = os.environ.get(name, "")
    try:
        value = float(text) if text else DEFAULTS[name]
    except ValueError:
        value = math.nan
    if not value > 0:
        raise RequestError(f"{name} is {text!r}. Give a positive number, or leave it out for {DEFAULTS[name]:g}.")
    return value


def raise_limits(**limits: float | None) -> None:
    """Set limits for this process and its children: files, gigabytes, ratio; None leaves one as it is."""
    names = {"files": FILES, "gigabytes": BYTES, "ratio": RATIO}
    os.environ.update({names[name]: str(value) for name, value in limits.items() if value is not None})


@dataclass
class Unpacking:
    """A file that is being unpacked, and what has come out of it so far.

    path: of the packed file, for messages. size: of it, bytes.
    """

    path: Path
    size: int
    files: int = 0
    written: int = 0
    limits: dict[str, float] = field(default_factory=lambda: {name: limit_of(name) for name in DEFAULTS})

    def add_file(self) -> None:
        """Count a file before it is unpacked. Raises RequestError for one too many."""
        self.files += 1
        if self.files > self.limits[FILES]:
            raise self._too_much(f"more than {self.limits[FILES]:,.0f} files", FILES)

    def add_bytes(self, count: int, packed: int) -> None:
        """Count bytes before they are written. packed: bytes of the file that have been read by now.

        Raises RequestError for too many.
        """
        self.written += count
        if self.written > self.limits[BYTES] * 1e9:
            raise self._too_much(f"more than {self.limits[BYTES]:g} GB", BYTES)
        if self.written > FREE_BYTES and self.written > self.limits[RATIO] * max(1, min(packed, self.size)):
            raise self._too_much(f"more than {self.limits[RATIO]:g} times the bytes that it was packed in", RATIO)

    def _too_much(self, limit: str, name: str) -> RequestError:
        return RequestError(
            f"{self.path} ({self.size / 1e6:.1f} MB) unpacks to {limit}, so it was not unpacked, and nothing of it is "
            f"left. If it is sound, set {name} in the environment (now {self.limits[name]:g}; in the studio the "
            "options --unpack-files, --unpack-gb and --unpack-ratio)."
        )


def gunzip(path: Path, target: IO[bytes]) -> Exception | None:
    """Unpack a gzip file into an open one, up to a torn or damaged end.

    Returns the error of that end, None for a whole file. Raises RequestError beyond the limits, OSError.
    """
    with path.open("rb") as stream, gzip.GzipFile(fileobj=stream) as packed:
        unpacking = Unpacking(path, os.fstat(stream.fileno()).st_size)
        try:
            while chunk := packed.read1(CHUNK):  # read1 returns whole data before it reaches the damage
                unpacking.add_bytes(len(chunk), stream.tell())
                target.write(chunk)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            return error
    return None


def read_packed(path: Path) -> bytes:
    """A file's content, unpacked if its name ends in .gz. Raises RequestError beyond the limits, OSError for damage."""
    if path.suffix != ".gz":
        return path.read_bytes()
    content = io.BytesIO()
    if (error := gunzip(path, content)) is not None:
        raise OSError(f"the gzip file ends early or is damaged ({error})")
    return content.getvalue()
