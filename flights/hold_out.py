"""Holding flights out: which ones a pattern names, and where one flight is cut in time."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from dynamics.errors import RequestError


def matching(names: Sequence[str], pattern: str, *, option: str) -> frozenset[int]:
    """Places of the file names that a pattern matches, with folders or without.

    option: of the command, for the message. Raises RequestError for a pattern that matches none or all of them.
    """
    places = frozenset(
        i for i, name in enumerate(names) if fnmatchcase(name, pattern) or fnmatchcase(Path(name).name, pattern)
    )
    if not places or len(places) == len(names):
        which = "none" if not places else "all"
        raise RequestError(
            f"{option} {pattern!r} matches {which} of {', '.join(names[:6])}. Wanted a pattern that matches some."
        )
    return places


def cuts_in_time(lengths: Sequence[int], held_out_share: float) -> tuple[int, ...]:
    """Rows of each segment that come before the held-out end of a flight. lengths: rows of its segments, in time."""
    limit, passed, cuts = round((1 - held_out_share) * sum(lengths)), 0, []
    for length in lengths:
        cuts.append(min(max(limit - passed, 0), length))
        passed += length
    return tuple(cuts)
