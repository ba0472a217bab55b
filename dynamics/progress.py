"""How far a long job is, for a bar or a page."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]  # share that is done, 0 to 1, and what is done now


def no_progress(share: float, stage: str) -> None:
    """Progress that nobody looks at."""
