"""The link has one vehicle: chosen by its heartbeat, kept by its address, and never lost to a single message."""

from __future__ import annotations

import socket
import time
from typing import Any

import pytest
from pymavlink.dialects.v20 import development as mavlink

from dynamics.errors import VehicleError
from runtime.link.connection import Endpoint
from runtime.link.framing import Frame, FrameParser
from runtime.link.link import Link, LinkCallbacks, LinkSettings
from runtime.link.peer import Peer
from runtime.link.telemetry import LinkEvent
from runtime.link.transport import UdpTransport
from runtime.link.vehicle_source import VehicleSource
from tests.support.deadline import wait_until
from tests.support.fake_vehicle import HOLD, OFFBOARD, FakeVehicle

pytestmark = pytest.mark.realtime

LOCAL = "127.0.0.1"


def open_link(settings: LinkSettings | None = None, callbacks: LinkCallbacks | None = None) -> Link:
    return Link(Endpoint("udpin", LOCAL, 0), settings, callbacks)


def address_of(link: Link) -> tuple[str, int]:
    assert isinstance(link.transport, UdpTransport)
    return LOCAL, link.transport.port


def frame_of(message: Any, component: int = 1) -> Frame:
    (frame,) = FrameParser().feed(bytes(message.pack(mavlink.MAVLink(None, 1, component))))
    return frame


class FedPeer:
    """A peer that has found its vehicle, and all that it answers."""

    def __init__(self) -> None:
        self.peer, self.answers = Peer(), list[Any]()
        self.feed(mavlink.MAVLink_heartbeat_message(2, 12, 0, HOLD, 3, 3), 0.0)
        self.feed(heartbeat("disarmed"), 0.1)

    def feed(self, message: Any, received: float) -> None:
        self.answers += self.peer.handle(frame_of(message), received).answers


HEARTBEATS = {"armed": (128, OFFBOARD), "disarmed": (0, OFFBOARD), "in HOLD": (128, HOLD)}


def heartbeat(shows: str) -> Any:
    base_mode, custom_mode = HEARTBEATS[shows]
    return mavlink.MAVLink_heartbeat_message(2, 12, base_mode, custom_mode, 4, 3)


@pytest.mark.parametrize("change", ["disarmed", "in HOLD"])
def test_a_single_message_stops_no_stream_in_the_air(change: str) -> None:
    harness = FedPeer()

    def still_flies() -> bool:
        return harness.peer.status.armed and harness.peer.status.mode == "OFFBOARD"

    harness.feed(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_IN_AIR), 0.5)
    for second, shows in enumerate(["armed", change, "armed", change, "armed"], start=1):
        harness.feed(heartbeat(shows), float(second))
        assert still_flies()
    harness.feed(heartbeat(change), 10.0)
    harness.feed(heartbeat(change), 20.0)  # two that are far apart agree on nothing
    assert still_flies()
    requests = [m for m in harness.answers if m.get_type() == "COMMAND_LONG"]
    assert {(m.command, m.param1) for m in requests} == {(mavlink.MAV_CMD_REQUEST_MESSAGE, 0.0)}
    harness.feed(heartbeat(change), 20.02)
    assert not still_flies()


def test_disarming_is_believed_at_once_on_the_ground_and_of_two_kinds_of_message() -> None:
    harness = FedPeer()
    harness.feed(heartbeat("armed"), 1.0)
    harness.feed(heartbeat("disarmed"), 2.0)
    assert harness.peer.status.armed
    harness.feed(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND), 2.1)
    assert not harness.peer.status.armed
    harness.feed(heartbeat("armed"), 3.0)
    harness.feed(heartbeat("disarmed"), 4.0)
    assert not harness.peer.status.armed


PERIPHERALS = [
    (100, mavlink.MAV_TYPE_CAMERA, 0),
    (156, mavlink.MAV_TYPE_ADSB, 0),
    (169, mavlink.MAV_TYPE_WINCH, 0),
    (1, mavlink.MAV_TYPE_CAMERA, 0),
    (191, mavlink.MAV_TYPE_QUADROTOR, 0),
    (154, mavlink.MAV_TYPE_GIMBAL, 12),
]


@pytest.mark.parametrize(("component", "kind", "autopilot"), PERIPHERALS)
def test_a_peripheral_that_speaks_first_is_not_the_vehicle(component: int, kind: int, autopilot: int) -> None:
    peer = Peer()
    peer.handle(frame_of(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3), component=component), 1.0)
    assert peer.address is None
    peer.handle(frame_of(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)), 2.0)
    assert peer.address == (1, 1)
    assert list(peer.candidates) == [(1, 1)]


def test_two_vehicles_on_a_link_are_refused_unless_one_is_chosen() -> None:
    with open_link() as link:
        target = address_of(link)
        with FakeVehicle(target, system=1), FakeVehicle(target, system=2):
            link.wait_for_vehicle(5.0)
            with pytest.raises(VehicleError, match=r"2 vehicles.*system 1.*system 2.*--system 1") as refusal:
                link.require_one_vehicle()
    assert refusal.value.exit_code == 4
    with open_link(LinkSettings(target_system=2)) as link:
        target = address_of(link)
        with FakeVehicle(target, system=1), FakeVehicle(target, system=2):
            assert link.wait_for_vehicle(5.0).system == 2
            link.require_one_vehicle()


@pytest.mark.parametrize("filtered", [False, True], ids=["at first", "once the kernel keeps to the vehicle"])
def test_a_stranger_with_the_vehicle_s_ids_is_not_heard_and_gets_nothing(filtered: bool) -> None:
    events: list[LinkEvent] = []
    with open_link(callbacks=LinkCallbacks(event=events.append)) as link, FakeVehicle(address_of(link)) as vehicle:
        link.wait_for_vehicle(5.0)
        if filtered:
            link.transport.keep_to_peer()
        _let_a_stranger_speak(link, vehicle)
        assert not link.status.armed
    assert [event.name for event in events].count("stranger_on_link") == 1


def _let_a_stranger_speak(link: Link, vehicle: FakeVehicle) -> None:
    with FakeVehicle(address_of(link)) as stranger:  # sends heartbeats with the same ids from another port
        stranger.custom_mode, stranger.armed = OFFBOARD, True
        for _ in range(20):
            stranger.send_odometry(x=7.0)
            link.send_rate_setpoint((0.0, 0.0, 0.0), 0.5)
        wait_until(lambda: link.source.rejected >= 5 and vehicle.count("SET_ATTITUDE_TARGET") == 20)
        vehicle.send_odometry(x=1.0)
        estimate = link.wait_for_estimate(None, time.monotonic() + 5.0)
        assert estimate is not None
        assert estimate.state[0] == 0.0
        assert estimate.state[1] == 1.0  # north
        assert not stranger.received


@pytest.mark.parametrize("roaming", [False, True])
def test_a_port_may_change_after_silence_an_address_only_of_a_vehicle_that_roams(roaming: bool) -> None:
    source = VehicleSource(roaming=roaming)
    assert source.accepts(("10.0.0.1", 1), 0.0)
    assert not source.accepts(("10.0.0.1", 2), 1.9)
    assert not source.accepts(("10.0.0.2", 1), 1.9)
    assert source.accepts(("10.0.0.1", 2), 2.1)
    assert not source.accepts(("10.0.0.1", 1), 2.2)
    assert source.accepts(("10.0.0.2", 1), 60.0) == roaming
    assert source.rejected == (3 if roaming else 4)


def test_a_flood_from_elsewhere_costs_the_vehicle_s_socket_nothing() -> None:
    with open_link() as link, FakeVehicle(address_of(link)) as vehicle:
        link.wait_for_vehicle(5.0)
        link.transport.keep_to_peer()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as flood:
            for n in range(3000):
                flood.sendto(b"\xfe\x05" * 700, address_of(link))
                if n % 100 == 0:
                    vehicle.send_odometry(x=0.001 * n)
        wait_until(lambda: link.estimate is not None and link.estimate.state[1] == pytest.approx(2.9))
        assert link.parser.skipped_bytes == 0
