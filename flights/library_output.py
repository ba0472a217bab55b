"""Output of third-party libraries, kept off the terminal: that of Python code and that of compiled code below it."""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import sys
from collections.abc import Iterator

STREAMS = (1, 2)  # standard output and standard error
MAX_BYTES = 1 << 16  # bytes, of a pipe: what does not fit is lost, so that a damaged log cannot fill memory or disk


class LibraryOutput:
    """What was printed inside `captured_output`; compiled code's is complete when it has ended."""

    def __init__(self) -> None:
        self._python = io.StringIO()
        self._compiled = b""

    @property
    def first_line(self) -> str:
        """The first line, empty where nothing was printed."""
        lines = (self._python.getvalue() + self._compiled.decode(errors="replace")).splitlines()
        return lines[0] if lines else ""


@contextlib.contextmanager
def captured_output() -> Iterator[LibraryOutput]:
    """Inside, nothing that the process prints reaches its terminal, compiled code's neither.

    Of the whole process: other threads' output is lost meanwhile.
    """
    output = LibraryOutput()
    with contextlib.redirect_stdout(output._python), contextlib.redirect_stderr(output._python), _piped(output):
        yield output


@contextlib.contextmanager
def _piped(output: LibraryOutput) -> Iterator[None]:
    """Lead the process's standard streams into a pipe that never blocks."""
    _flush()
    saved = {stream: os.dup(stream) for stream in STREAMS if _is_open(stream)}
    reader, writer = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        for stream in saved:
            os.dup2(writer, stream)
        yield
    finally:
        _flush()
        for stream, copy in saved.items():
            os.dup2(copy, stream)
            os.close(copy)
        os.close(writer)
        output._compiled = _rest(reader)
        os.close(reader)


def _is_open(stream: int) -> bool:
    try:
        os.fstat(stream)
    except OSError:
        return False
    return True


def _flush() -> None:
    """Write out what C's library still buffers, and Python, whose streams may be none or closed."""
    for stream in (sys.__stdout__, sys.__stderr__):
        with contextlib.suppress(AttributeError, OSError, ValueError):
            stream.flush()  # type: ignore[union-attr]
    ctypes.CDLL(None).fflush(None)


def _rest(reader: int) -> bytes:
    try:
        return os.read(reader, MAX_BYTES)
    except BlockingIOError:
        return b""
