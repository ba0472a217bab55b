"""The known name nearest to one that was misspelled, for messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

CUTOFF = 0.5  # of difflib's ratio: half of the letters in order


def nearest(word: str, known: Iterable[str]) -> str:
    """A remark that names the known word nearest to an unknown one; empty when none is near."""
    close = difflib.get_close_matches(word, list(known), n=1, cutoff=CUTOFF)
    return f"; did you mean {close[0]!r}?" if close else ""


def unknown(word: str, known: Iterable[str]) -> str:
    """The end of a message on an unknown name: the nearest one, and all."""
    names = list(known)
    return f"{nearest(word, names) or '.'} Known: {', '.join(names)}."
