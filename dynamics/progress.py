"""How far a long job is, for a bar or a page."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]  # share that is done, 0 to 1, and what is done now


def no_progress(share: float, stage: str) -> None:
    """Progress that nobody looks at."""


def part_of(progress: Progress, begin: float, end: float) -> Progress:
    """Progress of a part of a job. begin, end: shares of the job at which the part begins and ends."""
    return lambda share, stage: progress(begin + (end - begin) * share, stage)
