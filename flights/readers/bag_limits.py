"""The limits of all compressed files for bags: rosbags unpacks chunks, messages and files through the functions here.

rosbags has no option for that; its tables of decompressors are replaced when this module is imported. Whoever uses
rosbags beside us, outside `limits_of`, has its own decompressors as before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import zstandard
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2 import storage_mcap

from dynamics.packed_chunks import METHODS, unpacked
from dynamics.unpacking import CHUNK, Unpacking

_bag: ContextVar[Path | None] = ContextVar("bag", default=None)
_Method = Callable[..., bytes]


@contextmanager
def limits_of(bag: Path) -> Iterator[None]:
    """Inside, what rosbags unpacks is of this bag: a file or a folder."""
    token = _bag.set(bag)
    try:
        yield
    finally:
        _bag.reset(token)


def _limited(method: str, usual: _Method) -> _Method:
    """A decompressor within the limits of the bag that is being read; the usual one where none of ours is."""

    def decompress(content: bytes, *arguments: Any) -> bytes:
        bag = _bag.get()
        return usual(content, *arguments) if bag is None else unpacked(bytes(content), method, bag)

    return decompress


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


_zstd = rosbag2.zstd


def _open(file: Any, mode: str) -> Any:
    return _zstd.open(file, mode) if _bag.get() is None else _LimitedFile(file, Path(file.name))


for _table in (rosbag1.decompressors, storage_mcap.DECOMPRESSORS):
    _table.update({name: _limited(name, usual) for name, usual in _table.items() if name in METHODS})
rosbag2.zstd = SimpleNamespace(open=_open, decompress=_limited("zstd", _zstd.decompress))
