"""Whether a call's logs are several files of one flight, as blocks of log variables are.

The choice holds for the process, as that of the recorded vehicle does: a command reads its logs in several places.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class _Choice:
    def __init__(self) -> None:
        self.joined = False


_choice = _Choice()


def join_logs(joined: bool) -> None:
    """Read the logs of each call from now on as files of one flight, or as a flight each."""
    _choice.joined = joined


def logs_are_joined() -> bool:
    """Whether the logs of a call are files of one flight."""
    return _choice.joined


@contextmanager
def logs_joined(joined: bool = True) -> Iterator[None]:
    """Read the logs of a call as files of one flight inside of the block."""
    before = _choice.joined
    _choice.joined = joined
    try:
        yield
    finally:
        _choice.joined = before
