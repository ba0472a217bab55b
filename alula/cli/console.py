"""The terminal: what is printed there moves no cursor, rings no bell and turns no text around.

Names of files, and texts from logs, may hold any character. Those that a terminal obeys are shown as escapes, whoever
prints: `Console` for tables and bars, `escaping.Escaping` for all other output.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import IO

from rich.console import Console as RichConsole
from rich.segment import Segment

from alula.cli.escaping import Escaping, printable


class Console(RichConsole):
    """rich's console, for texts that may hold any character."""

    @property
    def file(self) -> IO[str]:
        """The stream that is written to, without the escaping of what rich has styled already."""
        stream = super().file
        return stream.stream if isinstance(stream, Escaping) else stream

    @file.setter
    def file(self, stream: IO[str]) -> None:
        self._file = stream

    def _render_buffer(self, buffer: Iterable[Segment]) -> str:
        segments = (Segment(printable(s.text), s.style) if not s.control else s for s in buffer)
        return super()._render_buffer(segments)
