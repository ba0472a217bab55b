"""The limits of all compressed files for bags: rosbags unpacks chunks, messages and files through the functions here.

rosbags has no option for that; its tables of decompressors are replaced when this module is imported.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import zstandard
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2 import storage_mcap

from dynamics.packed_chunks import unpacked
from dynamics.unpacking import CHUNK, Unpacking

_bag: ContextVar[Path] = ContextVar("bag")


@contextmanager
def limits_of(bag: Path) -> Iterator[None]:
    """Inside, what rosbags unpacks is of this bag: a file or a folder."""
    token = _bag.set(bag)
    try:
        yield
    finally:
        _bag.reset(token)


def _chunk(content: bytes, method: str) -> bytes:
    return unpacked(bytes(content), method, _bag.get())


class _LimitedFile:
    """A zstd file that `shutil.copyfileobj` reads; what it gives is counted."""

    def __init__(self, file: IO[bytes], path: Path) -> None:
        self._file, self._unpacking = file, Unpacking(path, path.stat().st_size)
        self._stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)

    def __enter__(self) -> _LimitedFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()  # type: ignore[no-untyped-call]

    def read(self, size: int = CHUNK) -> bytes:
        """The next bytes. Raises RequestError beyond the limits, ValueError for damage."""
        try:
            part = self._stream.read(size)
        except zstandard.ZstdError as error:
            raise ValueError(f"a file packed by zstd is damaged: {error}") from None
        self._unpacking.add_bytes(len(part), self._file.tell())
        return part


def _open(file: Any, _mode: str) -> _LimitedFile:
    return _LimitedFile(file, Path(file.name))


rosbag1.decompressors.update(bz2=lambda x: _chunk(x, "bz2"), lz4=lambda x: _chunk(x, "lz4"))
storage_mcap.DECOMPRESSORS.update(lz4=lambda x, _: _chunk(x, "lz4"), zstd=lambda x, _: _chunk(x, "zstd"))
rosbag2.zstd = SimpleNamespace(open=_open, decompress=lambda x: _chunk(x, "zstd"))
