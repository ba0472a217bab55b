"""Chunks of recordings (bz2, lz4, zstd), unpacked in steps that the limits of all compressed files are held to.

A chunk's declared size is of no use here: it was written by whoever made the file.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from pathlib import Path

import zstandard
from lz4.frame import LZ4FrameDecompressor

from dynamics.unpacking import CHUNK, Unpacking


def unpacked(content: bytes, method: str, path: Path) -> bytes:
    """A chunk's bytes. method: "bz2", "lz4" or "zstd". path: of the file that holds it.

    Raises RequestError beyond the limits, ValueError for damage.
    """
    size = path.stat().st_size if path.is_file() else sum(file.stat().st_size for file in path.rglob("*"))
    unpacking = Unpacking(path, size)
    target = BytesIO()
    try:
        for part in METHODS[method](content):
            unpacking.add_bytes(len(part), len(content))
            target.write(part)
    except (OSError, RuntimeError, EOFError, zstandard.ZstdError) as error:
        raise ValueError(f"a chunk packed by {method} is damaged: {error}") from None
    return target.getvalue()


def _bz2(content: bytes) -> Iterator[bytes]:
    while content:
        decompressor = bz2.BZ2Decompressor()
        yield decompressor.decompress(content, CHUNK)
        while not decompressor.eof and not decompressor.needs_input:
            yield decompressor.decompress(b"", CHUNK)
        if not decompressor.eof:
            raise EOFError("it ends early")
        content = decompressor.unused_data


def _lz4(content: bytes) -> Iterator[bytes]:
    while content:
        decompressor = LZ4FrameDecompressor()
        yield decompressor.decompress(content, CHUNK)
        while not decompressor.eof and not decompressor.needs_input:
            yield decompressor.decompress(b"", CHUNK)
        if not decompressor.eof:
            raise EOFError("it ends early")
        content = decompressor.unused_data or b""


def _zstd(content: bytes) -> Iterator[bytes]:
    declared, count = zstandard.frame_content_size(content), 0  # -1: the frame does not say
    with zstandard.ZstdDecompressor().stream_reader(BytesIO(content), read_across_frames=True) as stream:
        while part := stream.read(CHUNK):
            count += len(part)
            yield part
    if count < declared:  # which a reader of streams takes for their end
        raise EOFError("it ends early")


METHODS: Mapping[str, Callable[[bytes], Iterator[bytes]]] = {"bz2": _bz2, "lz4": _lz4, "zstd": _zstd}
