"""The stream of setpoints to the autopilot: nobody else sends one, and it leaves nothing that must not be held.

PX4 holds the last setpoint for COM_OF_LOSS_T. The flight logic ends its stream by runtime.flight.parting; this is for
everything else: a control thread that raises, hangs or dies, a supervisor that fails.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from runtime.flight.decision import Decision
from runtime.record.records import SetpointRecord

COPIES, SPACING = 5, 0.01  # of the last setpoint, s between them
Rates = tuple[float, float, float]
ZERO: Rates = (0.0, 0.0, 0.0)


class SetpointLink(Protocol):
    """Interface of a link that the stream needs."""

    def send_rate_setpoint(self, rate_body: Rates, thrust: float) -> bool:
        """Send SET_ATTITUDE_TARGET with body rates, FLU, rad/s, and thrust, 0..1; for one thread only."""


class SetpointStream:
    """Sends setpoints of decisions, and a still one in the end where the flight logic did not.

    newest: when the last setpoint left, s, monotonic; -inf before the first.
    open: whether the flight logic has not ended the stream since.
    on_hold: called before a setpoint that may be held is sent in place of the flight logic's.
    """

    def __init__(
        self,
        link: SetpointLink,
        record: Callable[[SetpointRecord, float], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """clock: of the flight, s."""
        self._clock = clock
        self.on_hold: Callable[[], None] | None = None
        self.newest = -float("inf")
        self.open = False
        self._link, self._record = link, record
        self._last: tuple[Rates, float] = (ZERO, 0.0)
        self._held_thrust = 0.0

    def send(self, decision: Decision) -> None:
        """Send a decision's setpoint; one without a setpoint ends the stream."""
        if decision.rate_body is None:
            self.open = False
            return
        x, y, z = decision.rate_body.tolist()
        self._last, self._held_thrust = ((x, y, z), decision.thrust), decision.held_thrust
        self.open = True
        self._link.send_rate_setpoint((x, y, z), decision.thrust)
        self.newest = self._clock()

    def take(self, decision: Decision, departed: float) -> None:
        """Take a decision whose setpoint has left already. departed: s."""
        assert decision.rate_body is not None
        x, y, z = decision.rate_body.tolist()
        self._last, self._held_thrust = ((x, y, z), decision.thrust), decision.held_thrust
        self.open, self.newest = True, departed

    def close(self) -> bool:
        """End an open stream with a setpoint that may be held, by the thread that sends. Returns whether it was in use.

        Never raises, so that whoever ends the stream can go on ending the flight.
        """
        if not self.open:
            return False
        self.open = False
        if self._last != (ZERO, self._held_thrust):
            self.hold(self._link.send_rate_setpoint)
        return True

    def hold(self, send: Callable[[Rates, float], object]) -> None:
        """Send the setpoint that may be held several times, by a function for this thread."""
        if self.on_hold is not None:
            self.on_hold()
        for copy in range(COPIES):
            if copy:
                time.sleep(SPACING)
            try:
                send(ZERO, self._held_thrust)
                now = self._clock()
                self._record(SetpointRecord(now, np.zeros(3), float("nan"), self._held_thrust, float("nan")), now)
            except Exception:  # a link or recorder that fails now must not keep the other copies from leaving
                continue
