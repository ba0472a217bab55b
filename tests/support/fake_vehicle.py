"""A vehicle of a few lines on a real UDP or TCP socket, for tests of the link: steered by a test."""

from __future__ import annotations

import socket
import threading
import time
from typing import Any

from pymavlink.dialects.v20 import development as mavlink

OFFBOARD = 6 << 16
HOLD = 4 << 16 | 3 << 24


class FakeVehicle:
    """Sends heartbeats at 20 Hz and answers TIMESYNC, commands and parameter requests in a thread of its own."""

    def __init__(
        self,
        target: tuple[str, int],
        *,
        system: int = 1,
        clock_offset: float = 100.0,
        key: bytes | None = None,
        timestamp: int = 0,
    ) -> None:
        """key: that it signs with, by pymavlink; None for none. timestamp: of its first signature."""
        self.system, self.clock_offset = system, clock_offset
        self.target = target
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.02)
        self.mav = mavlink.MAVLink(None, system, 1)
        self.parser = mavlink.MAVLink(None)
        self.parser.robust_parsing = True
        self.parser.signing = self.mav.signing
        self.mav.signing.secret_key, self.mav.signing.timestamp = key, timestamp
        self.mav.signing.sign_outgoing = key is not None
        self.custom_mode, self.armed, self.sends = HOLD, False, True
        self.acknowledgements: dict[int, list[int]] = {}  # results per command, in turn; the last one stays
        self.obeys = True
        self.parameters: dict[str, tuple[float, int]] = {}
        self.received: list[Any] = []
        self.lose_next = 0  # requests that stay unanswered
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> FakeVehicle:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.socket.close()

    def clock(self) -> float:
        return time.monotonic() + self.clock_offset

    def send(self, message: Any, component: int = 1) -> None:
        self.mav.srcComponent = component
        data = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        self.send_bytes(data)

    def send_bytes(self, data: bytes) -> None:
        self.socket.sendto(data, self.target)

    def send_heartbeat(self) -> None:
        mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        kind = mavlink.MAV_TYPE_QUADROTOR
        self.send(mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_PX4, mode, self.custom_mode, 3, 3))

    def send_odometry(self, **overrides: Any) -> None:
        self.send(odometry(**{"time_usec": int(self.clock() * 1e6), **overrides}))

    def count(self, name: str) -> int:
        return sum(message.get_type() == name for message in list(self.received))

    def _run(self) -> None:
        next_heartbeat = 0.0
        while not self._stop.is_set():
            if self.sends and time.monotonic() >= next_heartbeat:
                next_heartbeat = time.monotonic() + 0.05
                self.send_heartbeat()
            try:
                data = self.socket.recv(2048)
            except (TimeoutError, ConnectionRefusedError):
                continue
            for message in self.parser.parse_buffer(data) or []:
                self.received.append(message)
                if self.sends:
                    self._answer(message)

    def _answer(self, message: Any) -> None:
        match message.get_type():
            case "TIMESYNC" if message.tc1 == 0:
                self.send(mavlink.MAVLink_timesync_message(int(self.clock() * 1e9), message.ts1))
            case "COMMAND_LONG":
                self._answer_command(message)
            case "PARAM_REQUEST_READ" | "PARAM_SET" if self.lose_next > 0:
                self.lose_next -= 1
            case "PARAM_REQUEST_READ":
                self._send_parameter(message.param_id)
            case "PARAM_SET":
                self.parameters[message.param_id] = (message.param_value, message.param_type)
                self._send_parameter(message.param_id)

    def _send_parameter(self, name: str) -> None:
        if name in self.parameters:
            value, kind = self.parameters[name]
            self.send(mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self.parameters), 0))
        else:
            error = mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST
            self.send(mavlink.MAVLink_param_error_message(self.system, 191, name.encode(), -1, error))

    def _answer_command(self, message: Any) -> None:
        if self.lose_next > 0:
            self.lose_next -= 1
            return
        if self.obeys and message.command == mavlink.MAV_CMD_DO_SET_MODE:
            self.custom_mode = int(message.param2) << 16 | int(message.param3) << 24
        if self.obeys and message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = bool(message.param1)
        for result in self.acknowledgements.get(message.command, [0]):
            sender = (message.get_srcSystem(), message.get_srcComponent())
            self.send(mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, *sender))


def odometry(**overrides: Any) -> Any:
    """An ODOMETRY message of a vehicle at rest at the origin facing north, with some fields changed."""
    fields: dict[str, Any] = {
        "time_usec": 0, "frame_id": 1, "child_frame_id": 1, "x": 0.0, "y": 0.0, "z": 0.0, "q": [1.0, 0.0, 0.0, 0.0],
        "vx": 0.0, "vy": 0.0, "vz": 0.0, "rollspeed": 0.0, "pitchspeed": 0.0, "yawspeed": 0.0,
        "pose_covariance": [0.0] * 21, "velocity_covariance": [0.0] * 21, "reset_counter": 0,
    }  # fmt: skip
    return mavlink.MAVLink_odometry_message(**{**fields, **overrides})
