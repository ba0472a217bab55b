"""One line of the list: what was looked at, its state, what was measured, what to do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec

State = Literal["ok", "warning", "problem"]


class Check(msgspec.Struct, frozen=True):
    """A property of the computer.

    state: ok; warning, a flight is possible and worse; problem, it is not possible.
    measured: with units.
    advice: what to do, empty where there is nothing.
    """

    name: str
    state: State
    measured: str
    advice: str = ""


@dataclass(frozen=True)
class SystemFiles:
    """The kernel's files on this computer, or of another root in a test."""

    root: Path = Path("/")

    def text(self, path: str) -> str:
        """The content of a file without the white space around it; empty for one that cannot be read."""
        try:
            return (self.root / path).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return ""

    def texts(self, pattern: str) -> list[str]:
        """Contents of the files of a pattern, in the order of their paths."""
        paths = sorted(path.relative_to(self.root) for path in self.root.glob(pattern))
        return [text for path in paths if (text := self.text(str(path)))]
