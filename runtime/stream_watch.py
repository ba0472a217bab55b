"""The supervisor's watch over the stream of setpoints, for a control thread that hangs while its process lives."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from runtime.link.commands import command_message
from runtime.link.dialect import mavlink
from runtime.link.link import Link
from runtime.link.modes import mode_numbers
from runtime.setpoint_stream import Rates, SetpointStream

STANDSTILL = 0.15  # s without a setpoint, after which one that may be held replaces the last one
LOST = 0.7  # s, after which the autopilot is asked to land: its failsafe acts COM_OF_LOSS_T, 1 s, after the last one


class Streaming(Protocol):
    """Interface of a control thread that is watched."""

    stream: SetpointStream


class StreamWatch:
    """Sends what may be held in place of a setpoint that grows old, from the supervisor's thread."""

    def __init__(self, control: Streaming, link: Link) -> None:
        self._control, self._link = control, link
        self._held = self._landed = -math.inf  # the setpoint after which it was

    def check(self, now: float) -> str:
        """Act on a stream that stands still. now: s, monotonic. Returns a line about what was done, else empty."""
        stream = self._control.stream
        silence, newest = now - stream.newest, stream.newest
        if not stream.open or silence < STANDSTILL:
            return ""
        if silence > LOST and self._landed < newest:
            self._landed = newest
            self.end_stream()
            return f"the control thread has sent nothing for {silence:.1f} s: LAND is requested"
        if self._held < newest:
            self._held = newest
            stream.hold(self._send)
            return f"the control thread has sent nothing for {1e3 * silence:.0f} ms: a level setpoint was sent for it"
        return ""

    def end_stream(self) -> None:
        """Send what may be held and ask the autopilot to land, without an answer to wait for; nothing when not open."""
        stream = self._control.stream
        if not stream.open:
            return
        stream.hold(self._send)
        custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        main, sub = (float(number) for number in mode_numbers("LAND"))
        for attempt in range(2):
            message = command_message(self._link, mavlink.MAV_CMD_DO_SET_MODE, attempt, custom, main, sub)
            self._link.send(message)

    @property
    def _send(self) -> Callable[[Rates, float], object]:
        return lambda rates, thrust: self._link.send(self._link.rate_setpoint(rates, thrust))
