"""Blackbox logs as flight controllers write them: decoded by blackbox_decode where it is installed, or else refused.

No maintained parser can be installed (pip refuses orangebox 0.5), and the format's predictors are too many for one of
our own.
"""

from __future__ import annotations

import mmap
import shutil
import subprocess
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path

from dynamics.errors import DataError
from dynamics.unpacking import CHUNK, Unpacking
from flights.assembly import Assembly
from flights.log import LogContent
from flights.readers.blackbox_csv import read_decoded
from flights.readers.blackbox_fields import split_preamble
from flights.readers.table_head import lines_of
from flights.source import HEAD_BYTES, Source

DECODER = "blackbox_decode"
_START = b"H Product:Blackbox"
_MAX_SECONDS = 300.0


@dataclass(frozen=True)
class _Part:
    """One flight of a file. number: from 1. header: as it states it."""

    number: int
    size: int
    header: dict[str, str]


def matches(source: Source) -> bool:
    """Whether it begins with the header that every blackbox log has."""
    return source.head.startswith(_START)


def read(source: Source) -> LogContent:
    """The streams of the longest flight in the file. Raises DataError where nothing here decodes it."""
    decoder = shutil.which(DECODER)
    if decoder is None:
        raise DataError(
            f"this is a blackbox log, which {DECODER} of blackbox-tools decodes. Install it (on the PATH), or decode "
            "the log elsewhere and give its CSV, which needs no mapping."
        )
    parts = _parts(source.file)
    part = max(parts, key=lambda part: part.size)
    assembly = Assembly()
    assembly.note(f"decoded by {DECODER}")
    if len(parts) > 1:
        assembly.note(f"the file holds {len(parts)} flights; read: number {part.number}, the longest")
    with tempfile.TemporaryDirectory(prefix="alula-") as folder:
        table = Path(folder) / "decoded.csv"
        _decode([decoder, "--stdout", "--index", str(part.number), str(source.file.resolve())], source.path, table)
        with table.open("rb") as stream:
            lines = lines_of(Source(source.path, table, stream.read(HEAD_BYTES)))
        if split_preamble(lines)[0] < 0:
            raise DataError(f"{DECODER} made no table of this blackbox log. Decode it by hand to see why.")
        return read_decoded(table, lines, part.header, assembly)


def _parts(file: Path) -> list[_Part]:
    """The flights of a file, which follow each other, each with its header."""
    with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        starts, place = [], data.find(_START)
        while place >= 0:
            starts.append(place)
            place = data.find(_START, place + 1)
        edges = [*starts, len(data)]
        return [
            _Part(number + 1, edges[number + 1] - start, _header(data[start : start + HEAD_BYTES]))
            for number, start in enumerate(starts)
        ]


def _header(head: bytes) -> dict[str, str]:
    lines = []
    for line in head.split(b"\n"):
        if not line.startswith(b"H "):
            break
        lines.append(line.decode("latin-1"))
    return split_preamble(lines)[1]


def _decode(command: list[str], path: Path, table: Path) -> None:
    """Write what a decoder prints. Raises DataError where it fails, RequestError beyond the limits of packed files."""
    size = path.stat().st_size
    unpacking = Unpacking(path, size)
    late = threading.Event()
    with (
        subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ) as decoder,
        table.open("wb") as target,
    ):

        def give_up() -> None:
            late.set()
            decoder.kill()

        timer = threading.Timer(_MAX_SECONDS, give_up)
        timer.start()
        try:
            while decoder.stdout is not None and (part := decoder.stdout.read(CHUNK)):
                unpacking.add_bytes(len(part), size)
                target.write(part)
        except BaseException:
            decoder.kill()
            raise
        finally:
            timer.cancel()
    if late.is_set():
        raise DataError(f"{DECODER} did not end within {_MAX_SECONDS:.0f} s. Decode the log by hand.")
    if decoder.returncode:
        raise DataError(
            f"{DECODER} cannot decode this blackbox log (exit status {decoder.returncode}): it is damaged or cut off."
        )
