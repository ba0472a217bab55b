"""Messages to a service manager such as systemd: ready, alive, ending (sd_notify(3)), without its library."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from contextlib import suppress

from dynamics.errors import RequestError

MIN_WATCHDOG = 1.0  # s; the supervisor looks for finished ticks ten times in it, so that no single delay ends a flight


class ServiceManager:
    """The manager that started this process, if one did; otherwise every message is dropped.

    Nothing here blocks or raises: a manager that does not listen costs a flight nothing.
    """

    def __init__(self, address: str = "") -> None:
        """address: of its datagram socket, a path or, behind @, an abstract name; empty for none."""
        self._address = address.replace("@", "\0", 1) if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if address else None
        if self._socket is not None:
            self._socket.setblocking(False)
        self._ticks = -1
        self._stopped = False

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ) -> ServiceManager:
        """The manager that NOTIFY_SOCKET names.

        Raises RequestError for a watchdog (WATCHDOG_USEC, us) that would end a healthy flight.
        """
        watchdog = environment.get("WATCHDOG_USEC", "")
        if watchdog.isdigit() and 0 < 1e-6 * int(watchdog) < MIN_WATCHDOG:
            raise RequestError(
                f"the service manager's watchdog ends this process after {1e-6 * int(watchdog):g} s without a message; "
                f"at least {MIN_WATCHDOG:g} s are needed. Set WatchdogSec=2 in the unit."
            )
        return cls(environment.get("NOTIFY_SOCKET", ""))

    def ready(self) -> None:
        """The control loop runs; from now on the manager's watchdog counts."""
        self._send("READY=1")

    def progress(self, ticks: int) -> None:
        """Feed the watchdog if the control loop has ticked since the last call. ticks: done since the start."""
        if ticks != self._ticks:
            self._ticks = ticks
            self._send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Show one line in the manager's list of services."""
        self._send(f"STATUS={' '.join(text.split())}")

    def stopping(self) -> None:
        """The control loop has ended; from now on the manager's watchdog does not count. A second call does nothing."""
        if not self._stopped:
            self._stopped = True
            self._send("STOPPING=1")

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()

    def _send(self, message: str) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto(message.encode(), self._address)
