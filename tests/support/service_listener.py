"""Messages that a service manager has received on its socket."""

from __future__ import annotations

import socket


def drained(listener: socket.socket) -> list[str]:
    """The messages that wait, oldest first."""
    messages = []
    while True:
        try:
            messages.append(listener.recv(4096).decode())
        except BlockingIOError:
            return messages
