"""The address that the vehicle's datagrams come from: a stranger who knows its ids is not the vehicle."""

from __future__ import annotations

from math import inf
from typing import Any

Address = tuple[Any, ...]

PORT_PATIENCE = 2.0  # s of silence after which the vehicle may send from another port: a restarted autopilot or router


class VehicleSource:
    """Decides which datagrams with the vehicle's ids are the vehicle's. Pure: time comes in with each of them.

    The first one fixes address and port. Another port of the same address counts after a silence of PORT_PATIENCE,
    another address never, unless the vehicle roams. A stream (serial, TCP) has one other end and no address.

    roaming: whether the vehicle may change its address as it may change its port: a modem that changes networks.
    address: host and port; None before the first datagram and on a stream.
    rejected: datagrams with the vehicle's ids from elsewhere.
    stranger: where the latest of them came from.
    """

    def __init__(self, *, roaming: bool = False) -> None:
        self._roaming = roaming
        self._heard = -inf
        self.address: Address | None = None
        self.rejected = 0
        self.stranger: Address | None = None

    def accepts(self, source: Address | None, time: float) -> bool:
        """Whether a datagram with the vehicle's ids is the vehicle's, counted. time: of its arrival, s, monotonic."""
        if not self.admits(source, time):
            self.reject(source)
            return False
        self.accept(source, time)
        return True

    def admits(self, source: Address | None, time: float) -> bool:
        """Whether a datagram with the vehicle's ids may be the vehicle's by its address."""
        return source is None or source[:2] == self.address or self._may_move_to(source[:2], time)

    def accept(self, source: Address | None, time: float) -> None:
        """Take a datagram for the vehicle's: its address is the vehicle's from now on."""
        if source is not None:
            self.address, self._heard = source[:2], time

    def reject(self, source: Address | None) -> None:
        """Count a datagram of a stranger."""
        self.rejected += 1
        self.stranger = None if source is None else source[:2]

    def _may_move_to(self, source: Address, time: float) -> bool:
        if self.address is None:
            return True
        return time - self._heard >= PORT_PATIENCE and (self._roaming or source[0] == self.address[0])
