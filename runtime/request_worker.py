"""The request worker: a thread that passes the flight logic's requests on to the autopilot.

A request takes as long as the vehicle takes to answer; neither the control thread nor the supervisor waits for it.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping

from runtime.flight.engagement import AutopilotRequest
from runtime.link.commands import Confirmation, set_armed, set_mode
from runtime.link.link import Link

POLL_PERIOD = 0.1  # s
TIMEOUT = 2.0  # s for each request

Handlers = Mapping[AutopilotRequest, Callable[[], Confirmation]]


def link_handlers(link: Link) -> Handlers:
    """The functions that carry requests out on a link."""
    return {
        AutopilotRequest.OFFBOARD: lambda: set_mode(link, "OFFBOARD", timeout=TIMEOUT),
        AutopilotRequest.ARM: lambda: set_armed(link, True, timeout=TIMEOUT),
        AutopilotRequest.DISARM: lambda: set_armed(link, False, timeout=TIMEOUT),
        AutopilotRequest.LAND: lambda: set_mode(link, "LAND", timeout=TIMEOUT),
    }


class RequestWorker:
    """Carries out requests one at a time, until the flight is over.

    refusal: why the last request was not confirmed, empty when it was.
    """

    def __init__(
        self, requests: queue.SimpleQueue[AutopilotRequest], handlers: Handlers, is_over: Callable[[], bool]
    ) -> None:
        """requests: filled by the control thread. is_over: whether the control thread has ended."""
        self.refusal = ""
        self._requests, self._handlers, self._is_over = requests, handlers, is_over
        self._thread = threading.Thread(target=self._run, name="requests", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def join(self, timeout: float) -> bool:
        """Wait for the thread to end. timeout: s. Returns whether it has ended, or never started."""
        if self._thread.ident is None:
            return True
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            try:
                request = self._requests.get(timeout=POLL_PERIOD)
            except queue.Empty:
                if self._is_over():
                    return
                continue
            while not self._requests.empty():  # the newest counts: the flight logic repeats what is still open
                request = self._requests.get()
            answer = self._handlers[request]()
            self.refusal = "" if answer.confirmed else answer.reason
