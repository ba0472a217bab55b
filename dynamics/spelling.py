"""The name nearest to one that was misspelled, for messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

CUTOFF = 0.5  # of difflib's ratio: half of the letters in order


def nearest(word: str, names: Iterable[str]) -> str:
    """A remark that names the valid word nearest to an unknown one; empty when none is near."""
    close = difflib.get_close_matches(word, list(names), n=1, cutoff=CUTOFF)
    return f"; did you mean {close[0]!r}?" if close else ""


def unknown(word: str, names: Iterable[str]) -> str:
    """The end of a message on an unknown name: the nearest one, and all."""
    valid = list(names)
    return f"{nearest(word, valid) or '.'} Known: {', '.join(valid)}."
