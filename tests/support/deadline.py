"""Deadlines that leave out the time in which the host kept a thread of ours from the processors."""

from __future__ import annotations

import time
from typing import Any

from simulation.starvation import read_accounts


class Deadline:
    """A time by which something has to happen, s from now in which all our threads could run."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._start = read_accounts()

    @property
    def passed(self) -> bool:
        """Whether the time is over."""
        if time.monotonic() - self._start.time < self._seconds:
            return False
        since = read_accounts().since(self._start)
        return since.end - since.start - since.wait >= self._seconds


def wait_until(condition: Any, seconds: float = 10.0) -> None:
    """Wait for a condition with a deadline."""
    deadline = Deadline(seconds)
    while not condition():
        assert not deadline.passed, f"the condition did not come about within {seconds:g} s"
        time.sleep(0.002)
