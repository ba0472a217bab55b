"""Characters that a terminal obeys, and a stream that shows them as escapes. Imports the standard library alone."""

from __future__ import annotations

import io
import re
from typing import Any, TextIO

# C0 and C1 controls but tab and line feed, marks and overrides of direction, separators of lines, lone surrogates
OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")

COLOUR = re.compile(r"(\x1b\[[0-9;]*m)")


def printable(text: str) -> str:
    """Text with the characters that a terminal obeys as escapes such as \\x1b."""
    return OBEYED.sub(lambda match: match.group().encode("unicode_escape").decode(), text)


class Escaping(io.TextIOBase):
    """A stream that is written to with escapes."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self.stream = stream

    @property
    def buffer(self) -> Any:
        """The stream's own bytes, which JSON is written to."""
        return self.stream.buffer

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Of the stream."""
        return self.stream.encoding

    def write(self, text: str) -> int:
        """Write text."""
        if self.isatty():  # colours of libraries that write by themselves, as typer's messages do
            parts = COLOUR.split(text)
            text_shown = "".join(part if place % 2 else printable(part) for place, part in enumerate(parts))
        else:
            text_shown = printable(text)
        self.stream.write(text_shown)
        return len(text)

    def flush(self) -> None:
        """Flush what was written."""
        self.stream.flush()

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        return self.stream.isatty()

    def fileno(self) -> int:
        """Of the stream."""
        return self.stream.fileno()
