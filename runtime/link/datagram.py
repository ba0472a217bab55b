"""Datagrams that a thread beside the interpreter has read, and estimates that it has answered."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from dynamics.arrays import Floats
from runtime.link.vehicle_source import Address


class AnsweredEstimate(NamedTuple):
    """An estimate that a setpoint has answered already. time, stamp: s, ours and the vehicle's. state: (13,)."""

    time: float
    stamp: float
    state: Floats
    reset_counter: int


class Datagram(NamedTuple):
    """A datagram. received: s, monotonic. error: of the socket, 0 for none."""

    data: bytes
    received: float
    address: Address | None
    error: int
    answered: AnsweredEstimate | None


class ReadingThread(Protocol):
    """Interface of a thread that reads a socket instead of the link's."""

    def receive(self, patience: float) -> Datagram | None:
        """The next datagram, None after some seconds without one."""

    def close(self) -> None:
        """End the thread."""

    def __next__(self) -> int:
        """The next sequence number of frames under our ids."""
