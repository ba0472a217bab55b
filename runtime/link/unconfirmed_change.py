"""Changes that would end a setpoint stream in the air: believed when a second message agrees."""

from __future__ import annotations

from math import inf

CONFIRMATION_TIME = 3.0  # s between two messages that agree: two periods of HEARTBEAT, one of which may be lost


class UnconfirmedChange:
    """The latest report of a change that is not believed yet. Pure: time comes in with each report."""

    def __init__(self) -> None:
        self._reported: object = None
        self._time = -inf

    def reported(self, value: object, time: float) -> bool:
        """Whether a message within CONFIRMATION_TIME before this one reported the same value. time: s."""
        agrees = self.is_pending(value, time)
        self._reported, self._time = value, time
        return agrees

    def is_pending(self, value: object, time: float) -> bool:
        """Whether this value was reported within CONFIRMATION_TIME, and not contradicted since."""
        return self._reported is not None and value == self._reported and time - self._time <= CONFIRMATION_TIME

    def contradict(self) -> None:
        """Forget the report: a message shows the former value."""
        self._reported = None
