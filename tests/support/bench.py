"""A mock without sockets for tests: an autopilot with a kinematic vehicle, one client, simulated time."""

from __future__ import annotations

import math
from typing import Any

from sitl_mock.autopilot.autopilot import Autopilot, Behaviour
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.wire.dialect import mavlink
from sitl_mock.wire.streams import STEP, Role
from tests.support.kinematic_vehicle import KinematicVehicle

ARM, SET_MODE, SET_INTERVAL, GET_INTERVAL, REQUEST = 400, 176, 511, 510, 512
HOLD, RTL, LAND, OFFBOARD = 4 << 16 | 3 << 24, 4 << 16 | 5 << 24, 4 << 16 | 6 << 24, 6 << 16
FINE = 0.0005  # s, resolution of the times at which messages are heard


class Bench:
    """Sends messages to the mock and keeps every message that it sends, with its time.

    heard: (time, message) in order.
    """

    def __init__(
        self,
        *,
        role: Role = "onboard",
        parameters: dict[str, float] | None = None,
        mock: Autopilot | None = None,
        **behaviour: Any,
    ):
        self.vehicle: Any = KinematicVehicle() if mock is None else mock.vehicle
        self.mock = mock or Autopilot(self.vehicle, Parameters(parameters), Behaviour(**behaviour))
        self.link = self.mock.add_link("test", role)
        self.heard: list[tuple[float, Any]] = []
        self._packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True

    @property
    def time(self) -> float:
        return self.mock.time

    def send(self, message: Any) -> None:
        """Deliver a message now."""
        self.mock.receive(self.link, "test", message.pack(self._packer))

    def run(self, seconds: float) -> list[Any]:
        """Let time pass; returns what was sent meanwhile."""
        first = len(self.heard)
        for _ in range(round(seconds / STEP)):
            start = self.mock.time
            self.mock.step()
            for part in range(round(STEP / FINE)):
                self.hear(start + (part + 1) * FINE)
        return [message for _, message in self.heard[first:]]

    def hear(self, until: float | None = None) -> None:
        """Take what the mock has sent until a time, now by default."""
        time = self.time if until is None else until
        for frame in self.link.take(time):
            self.heard.extend((time, message) for message in self._parser.parse_buffer(frame) or [])

    def of(self, kind: str) -> list[Any]:
        """All messages of a kind so far."""
        return [message for _, message in self.heard if message.get_type() == kind]

    def times(self, kind: str) -> list[float]:
        """When those arrived, s."""
        return [time for time, message in self.heard if message.get_type() == kind]

    def command(self, number: int, *parameters: float, component: int = 1, system: int = 1) -> None:
        """Send a COMMAND_LONG."""
        seven = [*parameters, *[0.0] * (7 - len(parameters))]
        self.send(mavlink.MAVLink_command_long_message(system, component, number, 0, *seven))

    def request(self, number: int, *parameters: float) -> int:
        """Send a command and return the last result that it is answered with."""
        before = len(self.of("COMMAND_ACK"))
        self.command(number, *parameters)
        self.run(0.028)
        results = [ack.result for ack in self.of("COMMAND_ACK")[before:] if ack.command == number]
        assert results, f"command {number} was not acknowledged"
        return int(results[-1])

    def setpoint(self, thrust: float = 0.0, mask: int = 7, **fields: Any) -> None:
        """Send a SET_ATTITUDE_TARGET."""
        values = {"system": 1, "component": 1, "q": [1.0, 0, 0, 0], "rates": (0.0, 0.0, 0.0), **fields}
        self.send(
            mavlink.MAVLink_set_attitude_target_message(
                0, values["system"], values["component"], mask, values["q"], *values["rates"], thrust
            )
        )

    def stream(self, seconds: float, thrust: float = 0.0, rate: float = 50.0, **fields: Any) -> None:
        """Send setpoints at a rate for some seconds."""
        for _ in range(round(seconds * rate)):
            self.setpoint(thrust, **fields)
            self.run(1 / rate)

    def fly(self, height: float = 1.0) -> None:
        """Take off in OFFBOARD to some height, hovering under a setpoint stream."""
        self.stream(0.1 if self.mock.commander.offboard.rule == "measured" else 1.2)
        assert self.request(SET_MODE, 1, 6) == 0
        self.setpoint()
        assert self.request(ARM, 1) == 0
        while self.vehicle.position[2] < height:
            self.stream(0.1, thrust=0.6)
        self.vehicle.velocity[:] = 0.0
        self.stream(0.4, thrust=0.5)

    @property
    def heartbeat(self) -> Any:
        """The status that a heartbeat would carry now."""
        return self.mock.snapshot(self.mock.time).status

    def until(self, condition: Any, limit: float = 30.0) -> float:
        """Let time pass until a condition holds; returns the time it took."""
        start = self.time
        while not condition():
            assert self.time - start < limit, "the condition never held"
            self.run(STEP)
        return self.time - start


def finite(values: Any) -> bool:
    """Whether all numbers are finite."""
    return all(math.isfinite(value) for value in values)
