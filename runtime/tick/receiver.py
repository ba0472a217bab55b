"""A thread in C that reads a vehicle's socket: it answers estimates without the interpreter and passes bytes on."""

from __future__ import annotations

import ctypes
import socket
from typing import Any

import numpy as np

from runtime.link.datagram import AnsweredEstimate, Datagram
from runtime.link.vehicle_source import Address
from runtime.tick.library import TickLibrary


class Receiver:
    """The thread. Its context and result belong to the caller while no tick is armed.

    context: alula_context. result: alula_result. link: alula_link, for `know`.
    """

    def __init__(self, library: TickLibrary, descriptor: int) -> None:
        """descriptor: of a socket that gives up a wait by itself. Raises OSError where no thread can be started."""
        self._library, self._short = library, library.short
        self._handle = library.short.receiver_start(descriptor)
        if not self._handle:
            raise OSError("no thread for the receiver")
        structs = library.structs
        self.context: Any = structs["alula_context"].from_address(self._short.receiver_context(self._handle))
        self.result: Any = structs["alula_result"].from_address(self._short.receiver_result(self._handle))
        self.link: Any = structs["alula_link"]()
        self._link_at = ctypes.byref(self.link)
        self._datagram: Any = structs["alula_datagram"]
        self._addresses: dict[bytes, Address | None] = {}
        self._closed = False

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why a tick was left, by number."""
        return self._library.reasons

    def close(self) -> None:
        """End the thread; nothing is answered after this."""
        if not self._closed:
            self._closed = True
            self._library.waiting.receiver_stop(self._handle)

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            self.close()
            self._short.receiver_free(self._handle)

    def receive(self, patience: float) -> Datagram | None:
        """The next datagram, None after some seconds without one."""
        functions = self._library.waiting if patience > 0 and not self._short.receiver_waiting(self._handle) else None
        at = (functions or self._short).receiver_next(self._handle, patience if functions else 0.0)
        if not at:
            return None
        read = self._datagram.from_address(at)
        data = ctypes.string_at(read.bytes, read.size)
        answered = None
        if read.answered:
            answered = AnsweredEstimate(read.time, read.stamp, np.array(read.state), read.reset_counter)
        datagram = Datagram(data, read.received, self._address(bytes(read.address)), read.error, answered)
        self._short.receiver_read(self._handle)
        return datagram

    def know(self) -> None:
        """Take over `link`."""
        self._short.receiver_know(self._handle, self._link_at)

    def arm(self) -> None:
        """Let the next estimate be answered as the context says."""
        self._short.receiver_arm(self._handle)

    def disarm(self) -> None:
        """Answer no estimate until a tick is armed again; one that is being answered goes out."""
        self._short.receiver_disarm(self._handle)

    def claim(self) -> bool:
        """Disarm, and whether a setpoint has left since the tick was armed; the result holds it."""
        sent = self._short.receiver_try_claim(self._handle)
        return bool(self._library.waiting.receiver_claim(self._handle) if sent < 0 else sent)

    def __next__(self) -> int:
        """The next sequence number of frames under our ids."""
        return int(self._short.receiver_sequence(self._handle))

    def _address(self, raw: bytes) -> Address | None:
        if raw not in self._addresses:
            if len(self._addresses) > 64:
                self._addresses.clear()
            self._addresses[raw] = _address_of(raw)
        return self._addresses[raw]


def _address_of(raw: bytes) -> Address | None:
    """The address of a sockaddr, None for one that is neither IPv4 nor IPv6."""
    family, port = int.from_bytes(raw[:2], "little"), int.from_bytes(raw[2:4], "big")
    if family == socket.AF_INET:
        return socket.inet_ntop(socket.AF_INET, raw[4:8]), port
    if family == socket.AF_INET6:
        flow, scope = int.from_bytes(raw[4:8], "big"), int.from_bytes(raw[24:28], "little")
        return socket.inet_ntop(socket.AF_INET6, raw[8:24]), port, flow, scope
    return None
