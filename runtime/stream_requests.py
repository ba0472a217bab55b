"""The request of the vehicle's streams, repeated while they are too slow: a restarted PX4 sends its default rates."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping

REPEAT = 2.0  # s between requests


class StreamRequests:
    """Requests message rates in a thread of its own, because a request waits for its acknowledgement."""

    def __init__(self, request: Callable[[Mapping[str, float]], object], rates: Mapping[str, float]) -> None:
        """request: of rates, message name to Hz; it returns once they are acknowledged or not."""
        self._request, self._rates = request, rates
        self._last = float("-inf")
        self._thread: threading.Thread | None = None

    def send(self, now: float) -> None:
        """Request all rates, unless a request is under way. now: s."""
        if self._thread is not None and self._thread.is_alive():
            return
        self._last = now
        self._thread = threading.Thread(target=self._request, args=(self._rates,), name="streams", daemon=True)
        self._thread.start()

    def repeat(self, now: float) -> None:
        """Request them again if the last request was long enough ago. now: s."""
        if now - self._last >= REPEAT:
            self.send(now)
