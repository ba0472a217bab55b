"""The mock as a process: an autopilot between its transports, in real time or in lockstep with a controller."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from sitl_mock.autopilot.autopilot import Autopilot
from sitl_mock.vehicle.clock import UnevenTime
from sitl_mock.wire.link import Link
from sitl_mock.wire.transport import Transport

Pace = Literal["realtime", "lockstep"]
CATCH_UP = 0.1  # s that a delayed process catches up; beyond it simulated time slips, as PX4's simulation does
RECEPTION_TIME = 0.002  # s spent on arrived messages before the next pass of the vehicle
LOCKSTEP_PATIENCE = 0.5  # s without a setpoint after which lockstep follows the clock
LOCKSTEP_STEPS = 25  # passes after which a setpoint stays without an estimate: the client requested none


@dataclass(slots=True)
class Wire:
    """A link with the transport that carries it."""

    link: Link
    transport: Transport


class Server:
    """Carries bytes between an autopilot and its transports while simulated time follows the clock.

    pace: realtime follows the clock times `speed`; lockstep advances to the next estimate whenever a setpoint
        arrives and follows the clock only while none does.
    speed: simulated seconds per second.
    uneven: how simulated time deviates from that in real time; None for not at all.
    slipped: simulated time that a starved process gave up, s.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        wires: list[Wire],
        *,
        pace: Pace = "realtime",
        speed: float = 1.0,
        uneven: UnevenTime | None = None,
    ):
        self.autopilot = autopilot
        self.wires = wires
        self.slipped = 0.0
        self._pace = pace
        self._uneven = uneven if pace == "realtime" else None
        self._speed = speed * (1.0 + (self._uneven.drift if self._uneven else 0.0))
        self._began = time.monotonic()
        self._start = time.monotonic()
        self._origin = autopilot.time
        self._setpoints = 0
        self._free_from = 0.0
        for wire in wires:
            wire.link.punctual = pace == "lockstep"

    def run(self, stopped: Callable[[], bool]) -> None:
        """Serve until `stopped` returns true, then close the transports."""
        self._start = time.monotonic()
        self._origin = self.autopilot.time
        try:
            while not stopped():
                self.serve_once()
        finally:
            for wire in self.wires:
                wire.transport.close()

    def serve_once(self) -> None:
        """Wait for bytes or for the time at which the next pass or message is due, and handle them."""
        self._wait()
        self._receive()
        if self._pace == "lockstep" and self._follow_setpoints():
            self._send(self.autopilot.time)
            return
        if self._uneven is not None:
            self._origin += self._uneven.step(time.monotonic() - self._began)
        now = self._now()
        if now - self.autopilot.time > CATCH_UP:
            self._slip(now - self.autopilot.time)
            now = self._now()
        while self.autopilot.next_step <= now:
            self.autopilot.step()
            self._send(now)
        self._send(now)

    def _now(self) -> float:
        """The simulated time that corresponds to the clock, s."""
        return self._origin + (time.monotonic() - self._start) * self._speed

    def _slip(self, seconds: float) -> None:
        self.slipped += seconds
        self._origin -= seconds

    def _wait(self) -> None:
        departure = min((wire.link.next_departure() for wire in self.wires), default=self.autopilot.next_step)
        due = min(self.autopilot.next_step, departure)
        handles = [number for wire in self.wires for number in wire.transport.filenos()]
        select.select(handles, [], [], max(0.0, (due - self._now()) / self._speed))

    def _receive(self) -> None:
        limit = time.monotonic() + RECEPTION_TIME
        for wire in self.wires:
            for peer, data in wire.transport.receive():
                # at most one pass later than the vehicle, whose state the answers describe
                now = max(self.autopilot.time, min(self._now(), self.autopilot.next_step))
                self.autopilot.receive(wire.link, peer, data, now)
                if time.monotonic() > limit:
                    break  # a flood: what the socket cannot hold is lost, and the vehicle flies on

    def _send(self, now: float) -> None:
        for wire in self.wires:
            for frame in wire.link.take(now):
                wire.transport.send(frame)

    def _follow_setpoints(self) -> bool:
        """Advance to the next estimate for a new setpoint. Returns whether setpoints keep coming."""
        count = self.autopilot.commander.offboard.count
        if count != self._setpoints:
            self._setpoints = count
            self._free_from = time.monotonic() + LOCKSTEP_PATIENCE
            for _ in range(LOCKSTEP_STEPS):
                self.autopilot.step()
                if self.autopilot.estimates_sent:
                    break
                self._send(self.autopilot.time)
        following = time.monotonic() < self._free_from
        if following:
            self._start, self._origin = time.monotonic(), self.autopilot.time
        return following
