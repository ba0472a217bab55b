"""Commands are repeated until answered, and HEARTBEAT decides what has come about."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import development as mavlink

from dynamics.errors import RequestError
from runtime.link import commands
from runtime.link.connection import Endpoint
from runtime.link.link import Link
from runtime.link.transport import UdpTransport
from tests.support.deadline import wait_until
from tests.support.fake_vehicle import FakeVehicle

pytestmark = pytest.mark.realtime

ACCEPTED, TEMPORARILY_REJECTED, DENIED = 0, 1, 2
SET_MODE, ARM = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM


@pytest.fixture
def link() -> Iterator[Link]:
    with Link(Endpoint("udpin", "127.0.0.1", 0)) as opened:
        yield opened


@pytest.fixture
def vehicle(link: Link) -> Iterator[FakeVehicle]:
    assert isinstance(link.transport, UdpTransport)
    with FakeVehicle(("127.0.0.1", link.transport.port)) as fake:
        link.wait_for_vehicle(5.0)
        yield fake


def test_a_mode_is_confirmed_by_the_heartbeat(link: Link, vehicle: FakeVehicle) -> None:
    result = commands.set_mode(link, "offboard")
    assert result.confirmed
    assert link.status.mode == "OFFBOARD"
    request = next(m for m in vehicle.received if m.get_type() == "COMMAND_LONG")
    assert (request.param1, request.param2, request.param3) == (1.0, 6.0, 0.0)


def test_a_first_acknowledgement_that_is_taken_back_is_not_trusted(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.obeys = False
    vehicle.acknowledgements[SET_MODE] = [ACCEPTED, TEMPORARILY_REJECTED]
    result = commands.set_mode(link, "OFFBOARD")
    assert not result.confirmed
    assert result.acknowledgements == ("accepted", "temporarily_rejected")
    assert "stream of setpoints" in result.reason


def test_a_double_acknowledgement_of_a_mode_that_came_is_success(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.acknowledgements[SET_MODE] = [ACCEPTED, ACCEPTED]
    assert commands.set_mode(link, "LAND").confirmed
    assert link.status.mode == "LAND"


def test_an_acknowledged_mode_that_never_shows_is_a_failure(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.obeys = False
    result = commands.set_mode(link, "OFFBOARD", timeout=0.4)
    assert not result.confirmed
    assert "heartbeat did not show it" in result.reason


def test_a_refused_arming_has_its_reason(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.obeys = False
    vehicle.acknowledgements[ARM] = [TEMPORARILY_REJECTED]
    result = commands.set_armed(link, True)
    assert not result.confirmed
    assert "refused arming: temporarily_rejected" in result.reason


def test_arming_and_forced_disarming(link: Link, vehicle: FakeVehicle) -> None:
    assert commands.set_armed(link, True).confirmed
    assert commands.set_armed(link, False, force=True).confirmed
    arming = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    forced = [m for m in vehicle.received if m.get_type() == "COMMAND_LONG" and m.command == arming][-1]
    assert (forced.param1, forced.param2) == (0.0, 21196.0)


def test_lost_requests_are_repeated_with_their_count(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.lose_next = 2
    assert commands.request_rates(link, {"ODOMETRY": 100.0}) == {"ODOMETRY": "accepted"}
    requests = [m for m in vehicle.received if m.get_type() == "COMMAND_LONG"]
    assert [m.confirmation for m in requests] == [0, 1, 2]
    assert {(m.command, m.param1, m.param2) for m in requests} == {(511, 331.0, 10000.0)}


def test_a_silent_vehicle_gives_no_answer(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.lose_next = 100
    assert commands.send_command(link, 511, 331.0, timeout=0.05, attempts=3) == "no_answer"
    result = commands.set_mode(link, "OFFBOARD", timeout=0.3)
    assert "did not answer" in result.reason


def test_streams_are_requested_once_each_after_one_without_an_answer(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.lose_next = 100
    rates = {"ODOMETRY": 100.0, "HIGHRES_IMU": 100.0, "SYS_STATUS": 1.0}
    assert commands.request_rates(link, rates) == dict.fromkeys(rates, "no_answer")
    assert [m.param1 for m in vehicle.received if m.get_type() == "COMMAND_LONG"] == [331.0] * 4 + [105.0, 1.0]


def test_acknowledgements_to_others_are_not_ours(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.lose_next = 1
    with link.listening(lambda message: message if message.get_type() == "COMMAND_ACK" else None) as received:
        vehicle.send(mavlink.MAVLink_command_ack_message(511, DENIED, 0, 0, 255, 190))
        stranger = received.get(timeout=5.0)
    assert commands.acknowledgement(link, stranger, 511) is None
    assert commands.send_command(link, 511, 331.0, timeout=0.1) == "accepted"


def test_in_progress_is_not_the_last_word(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.acknowledgements[511] = [5, ACCEPTED]
    assert commands.send_command(link, 511, 331.0) == "accepted"


def test_a_refused_rate_is_reported(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.acknowledgements[511] = [4]
    assert commands.request_rates(link, {"HEARTBEAT": 10.0}) == {"HEARTBEAT": "failed"}


def test_what_does_not_exist_is_refused_before_anything_is_sent(link: Link, vehicle: FakeVehicle) -> None:
    with pytest.raises(RequestError, match="no mode of PX4"):
        commands.set_mode(link, "TURBO")
    with pytest.raises(RequestError, match="ODOMETRIE"):
        commands.request_rates(link, {"ODOMETRIE": 100.0})
    wait_until(lambda: vehicle.count("TIMESYNC") > 3)
    assert vehicle.count("COMMAND_LONG") == 0
