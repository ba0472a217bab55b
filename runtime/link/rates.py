"""Measured message rates and intervals over a sliding window."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import pairwise

import msgspec

from runtime.link.dialect import MESSAGE_IDS

WINDOW = 3.0  # s
_MAX_ARRIVALS = 4000  # of one message within the window


class StreamRate(msgspec.Struct, frozen=True):
    """A message's rate within a window.

    rate: Hz.
    median, p1, p99: of the intervals, s.
    count: messages.
    """

    rate: float
    median: float
    p1: float
    p99: float
    count: int


def arrival_rate(times: Sequence[float], now: float) -> float:
    """Arrivals per second, Hz, in a window that reaches up to now. times: in order, s.

    Counted from the first one; the silence after a stream that stopped within the window counts.
    """
    if len(times) < 2:
        return 0.0
    longest = max(after - before for before, after in pairwise(times))
    return (len(times) - 1) / max(times[-1] - times[0], now - times[0] - longest, 1e-6)


SILENT = StreamRate(0.0, float("inf"), float("inf"), float("inf"), 0)


class RateMeter:
    """Counts arrivals per message id. Pure: times are arguments, s on our monotonic clock."""

    def __init__(self, window: float = WINDOW) -> None:
        self._window = window
        self._arrivals: dict[int, deque[float]] = {}

    def handle(self, message_id: int, received: float) -> None:
        """Count a message."""
        arrivals = self._arrivals.get(message_id)
        if arrivals is None:
            arrivals = self._arrivals[message_id] = deque(maxlen=_MAX_ARRIVALS)
        arrivals.append(received)
        while arrivals[0] < received - self._window:
            arrivals.popleft()

    def rate(self, name: str, now: float, window: float = WINDOW) -> StreamRate:
        """The rate of a message. window: s before now, at most the one of the constructor."""
        arrivals = tuple(self._arrivals.get(MESSAGE_IDS.get(name, -1), ()))
        times = [time for time in arrivals if time >= now - window]
        if len(times) < 2:
            return msgspec.structs.replace(SILENT, count=len(times))
        intervals = sorted(after - before for before, after in pairwise(times))
        return StreamRate(
            arrival_rate(times, now),
            intervals[len(intervals) // 2],
            intervals[len(intervals) // 100],
            intervals[-1 - len(intervals) // 100],
            len(times),
        )
