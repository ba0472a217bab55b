"""An independent end of the link for tests: pymavlink over UDP, nothing of ours; it keeps all messages and their times.

All times are the listener's monotonic clock, s.
"""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import TracebackType
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from tests.support.deadline import Deadline

SET_MODE, ARM_DISARM, SET_INTERVAL, REQUEST_MESSAGE = 176, 400, 511, 512
OFFBOARD = 6 << 16
HOLD, RTL, LAND = (4 << 16 | sub << 24 for sub in (3, 5, 6))
LEVEL = (1.0, 0.0, 0.0, 0.0)
PERIOD = 0.01  # s between two setpoints
POLL = 0.2  # s between two looks at a deadline, where nothing arrives


def attitude_target(
    thrust: float,
    *,
    mask: int = 7,
    attitude: tuple[float, ...] = LEVEL,
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
    target: tuple[int, int] = (1, 1),
) -> Any:
    """A SET_ATTITUDE_TARGET. thrust: 0..1. mask: type_mask. attitude: FRD to NED. rates: FRD, rad/s."""
    return mavlink.MAVLink_set_attitude_target_message(0, *target, mask, list(attitude), *rates, thrust)


class RawLink:
    """A client that listens to a port, answers its sender, and keeps all messages with their times.

    component: its MAVLink component.
    kind: MAV_TYPE of its heartbeat, None for no heartbeat.
    """

    def __init__(self, port: int, *, component: int = 191, kind: int | None = 18):
        self.heard: list[tuple[float, Any]] = []
        self._kind = kind
        self._packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=component)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._arrival = threading.Condition()
        self._sending = threading.Lock()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.bind(("127.0.0.1", port))
        self._socket.settimeout(0.2)
        self._vehicle: Any = None
        self._open = True
        self._threads = [threading.Thread(target=self._listen), threading.Thread(target=self._speak)]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> RawLink:
        self.wait_for("HEARTBEAT")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open = False
        for thread in self._threads:
            thread.join()
        self._socket.close()

    def _listen(self) -> None:
        while self._open:
            try:
                data, self._vehicle = self._socket.recvfrom(65536)
            except TimeoutError:
                continue
            now = time.monotonic()
            parsed = self._parser.parse_buffer(data) or []
            with self._arrival:
                self.heard.extend((now, message) for message in parsed)
                self._arrival.notify_all()

    def _speak(self) -> None:
        beat = 0.0
        while self._open:
            if self._kind is not None and self._vehicle is not None and time.monotonic() - beat > 1.0:
                beat = time.monotonic()
                self.send(mavlink.MAVLink_heartbeat_message(self._kind, 8, 0, 0, 4, 3))
            time.sleep(0.05)

    @property
    def vehicle(self) -> Any:
        """The vehicle's address."""
        return self._vehicle

    def fall_silent(self) -> None:
        """Stop the own heartbeat."""
        self._kind = None

    def send(self, message: Any) -> float:
        """Send a message; returns when."""
        with self._sending:
            now = time.monotonic()
            self._socket.sendto(message.pack(self._packer), self._vehicle)
            self._packer.seq = (self._packer.seq + 1) % 256
        return now

    def send_bytes(self, data: bytes) -> None:
        """Send whatever bytes as one datagram."""
        self._socket.sendto(data, self._vehicle)

    def since(self, start: float, kind: str) -> list[tuple[float, Any]]:
        """What was heard of a kind since a time, with when."""
        with self._arrival:
            return [(at, message) for at, message in self.heard if at >= start and message.get_type() == kind]

    def wait_for(
        self,
        kind: str,
        accept: Callable[[Any], bool] = lambda _: True,
        *,
        since: float | None = None,
        within: float = 10.0,
    ) -> tuple[float, Any]:
        """The first message of a kind that is accepted, heard since a time (now), with when it was heard."""
        start = time.monotonic() if since is None else since
        deadline = Deadline(within)
        index = 0
        with self._arrival:
            while True:
                while index < len(self.heard):
                    at, message = self.heard[index]
                    index += 1
                    if at >= start and message.get_type() == kind and accept(message):
                        return at, message
                if deadline.passed:
                    raise AssertionError(f"no such {kind} within {within} s")
                self._arrival.wait(POLL)

    def command(
        self, identifier: int, *parameters: float, target: tuple[int, int] = (1, 1), within: float = 5.0
    ) -> tuple[float, Any]:
        """Send a COMMAND_LONG; returns how long its first ACK took, s, and the ACK."""
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        sent = self.send(mavlink.MAVLink_command_long_message(*target, identifier, 0, *padded))
        at, ack = self.wait_for("COMMAND_ACK", lambda ack: ack.command == identifier, since=sent, within=within)
        return at - sent, ack

    def result(self, identifier: int, *parameters: float) -> int:
        """Send a command; returns the result of its first ACK."""
        return int(self.command(identifier, *parameters)[1].result)

    def set_rate(self, identifier: int, rate: float) -> None:
        """Request a message at a rate, Hz."""
        assert self.result(SET_INTERVAL, identifier, 1e6 / rate) == 0

    def set_mode(self, custom_mode: int) -> int:
        """Request a mode; returns the ACK's result."""
        return self.result(SET_MODE, 1, custom_mode >> 16 & 0xFF, custom_mode >> 24)

    def arm(self) -> int:
        """Request arming; returns the ACK's result."""
        return self.result(ARM_DISARM, 1)

    def disarm(self, *, force: bool = False) -> int:
        """Request disarming; returns the ACK's result."""
        return self.result(ARM_DISARM, 0, 21196 if force else 0)

    def newest(self, kind: str) -> Any:
        """The newest message of a kind."""
        with self._arrival:
            return next(message for _, message in reversed(self.heard) if message.get_type() == kind)

    def watching_mode(self) -> AbstractContextManager[Stream]:
        """Request HEARTBEAT 100 times a second; PX4's own comes once."""
        request = mavlink.MAVLink_command_long_message(1, 1, REQUEST_MESSAGE, 0, 0, 0, 0, 0, 0, 0, 0)
        return self.setpoints(lambda _: request)

    def wait_for_mode(self, custom_mode: int, *, since: float | None = None, within: float = 5.0) -> float:
        """When a HEARTBEAT first showed a mode."""
        return self.wait_for("HEARTBEAT", lambda beat: beat.custom_mode == custom_mode, since=since, within=within)[0]

    def state(self) -> Any:
        """The HEARTBEAT of now."""
        sent = self.send(mavlink.MAVLink_command_long_message(1, 1, REQUEST_MESSAGE, 0, 0, 0, 0, 0, 0, 0, 0))
        return self.wait_for("HEARTBEAT", since=sent)[1]

    def messages(self, kind: str, seconds: float) -> list[tuple[float, Any]]:
        """What is heard of a kind during the next seconds."""
        start = time.monotonic()
        time.sleep(seconds)
        return self.since(start, kind)

    @contextmanager
    def setpoints(self, make: Callable[[RawLink], Any], period: float = PERIOD) -> Iterator[Stream]:
        """Send what `make` returns every period, s, as long as the context lasts."""
        stream = Stream(self, make, period)
        try:
            yield stream
        finally:
            stream.stop()


class Stream:
    """A stream of setpoints at a steady period, in its own thread; `make` may be changed while it runs."""

    def __init__(self, link: RawLink, make: Callable[[RawLink], Any], period: float):
        self.make, self.period = make, period
        self.last = -math.inf
        self.sent: list[float] = []
        self._link, self._open = link, True
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        due = time.monotonic()
        while self._open:
            message = self.make(self._link)
            if message is not None:
                self.last = self._link.send(message)
                self.sent.append(self.last)
            due = max(due + self.period, time.monotonic() - 0.05)
            time.sleep(max(0.0, due - time.monotonic()))

    def stop(self) -> float:
        """End the stream; returns when its last setpoint left."""
        self._open = False
        self._thread.join()
        return self.last


def hover_at(height: float, *, target: tuple[float, float] = (0.0, 0.0)) -> Callable[[RawLink], Any]:
    """A setpoint maker that climbs to and keeps a height, m, over the origin, by attitude and thrust (type_mask 7).

    target: NED x and y of the hover, m.
    """

    def make(link: RawLink) -> Any:
        here = link.newest("ODOMETRY")
        climb = 1.0 * (height + here.z) + 1.2 * here.vz
        thrust = min(max(0.5 * (1.0 + climb / 5.0), 0.2), 0.75)
        pitch = max(min(0.15 * (here.x - target[0]) + 0.25 * here.vx, 0.25), -0.25)
        roll = max(min(-0.15 * (here.y - target[1]) - 0.25 * here.vy, 0.25), -0.25)
        return attitude_target(thrust, attitude=from_euler(roll, pitch, 0.0))

    return make


def from_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """The quaternion (w, x, y, z) of roll, pitch and yaw, rad (Z-Y-X)."""
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
