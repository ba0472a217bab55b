"""Parameters are read and set in the vehicle's own type, integers byte-wise."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.link import parameters
from runtime.link.connection import Endpoint
from runtime.link.link import Link
from runtime.link.parameters import decode_value, encode_value, read_parameter, set_parameter
from runtime.link.transport import UdpTransport
from tests.support.fake_vehicle import FakeVehicle

pytestmark = pytest.mark.realtime

REAL, INT = 9, 6


@pytest.fixture
def link() -> Iterator[Link]:
    with Link(Endpoint("udpin", "127.0.0.1", 0)) as opened:
        yield opened


@pytest.fixture
def vehicle(link: Link) -> Iterator[FakeVehicle]:
    assert isinstance(link.transport, UdpTransport)
    with FakeVehicle(("127.0.0.1", link.transport.port)) as fake:
        fake.parameters = {"THR_MDL_FAC": (0.25, REAL), "COM_OBL_RC_ACT": (encode_value(4, INT), INT)}
        link.wait_for_vehicle(5.0)
        yield fake


@given(st.integers(-(2**22), 2**22))
def test_integers_travel_byte_wise(value: int) -> None:
    wire = encode_value(value, INT)
    assert struct.pack("<f", wire) == struct.pack("<i", value)
    assert decode_value(wire, INT) == value


@pytest.mark.parametrize(("value", "kind"), [(200, 1), (-3, 2), (60000, 3), (-30000, 4), (7, 5), (0.1, 9)])
def test_every_type_survives(value: float, kind: int) -> None:
    assert decode_value(encode_value(value, kind), kind) == pytest.approx(value)


@pytest.mark.parametrize(("value", "kind"), [(300, 1), (2**40, 6), (-1, 5)])
def test_what_does_not_fit_is_refused(value: float, kind: int) -> None:
    with pytest.raises(ValueError, match="does not fit"):
        encode_value(value, kind)


def test_values_are_read_by_name(link: Link, vehicle: FakeVehicle) -> None:
    assert read_parameter(link, "THR_MDL_FAC").value == pytest.approx(0.25)
    action = read_parameter(link, "COM_OBL_RC_ACT")
    assert (action.value, action.type) == (4, INT)


def test_an_unknown_name_is_an_error(link: Link, vehicle: FakeVehicle) -> None:
    missing = read_parameter(link, "NO_SUCH_THING")
    assert (missing.value, missing.error) == (None, "does_not_exist")


def test_a_lost_request_is_repeated(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.lose_next = 2
    assert read_parameter(link, "THR_MDL_FAC", timeout=0.1).value == pytest.approx(0.25)


def test_a_vehicle_that_does_not_answer_is_not_asked_for_every_name(link: Link, vehicle: FakeVehicle) -> None:
    vehicle.lose_next = 100
    names = ["THR_MDL_FAC", *(f"NAME_{number}" for number in range(5))]
    values = parameters.read_parameters(link, names, timeout=0.1)
    assert {value.error for value in values.values()} == {"no_answer"}
    assert list(values) == names
    requests = [message.param_id for message in vehicle.received if message.get_type() == "PARAM_REQUEST_READ"]
    assert requests == ["THR_MDL_FAC"] * 4


def test_a_value_is_set_in_the_vehicle_s_type(link: Link, vehicle: FakeVehicle) -> None:
    assert set_parameter(link, "COM_OBL_RC_ACT", 5).value == 5
    assert vehicle.parameters["COM_OBL_RC_ACT"] == (pytest.approx(encode_value(5, INT)), INT)
    assert set_parameter(link, "THR_MDL_FAC", 0.3).error == ""


def test_a_value_that_is_not_taken_is_an_error(link: Link, vehicle: FakeVehicle) -> None:
    class Stubborn(dict[str, tuple[float, int]]):
        def __setitem__(self, name: str, value: tuple[float, int]) -> None:
            return

    vehicle.parameters = Stubborn(vehicle.parameters)
    result = set_parameter(link, "THR_MDL_FAC", 0.9)
    assert (result.value, result.error) == (pytest.approx(0.25), "not_taken")


def test_setting_what_does_not_exist_sends_nothing(link: Link, vehicle: FakeVehicle) -> None:
    assert set_parameter(link, "NO_SUCH_THING", 1.0).error == "does_not_exist"
    assert vehicle.count("PARAM_SET") == 0


def test_several_are_read_in_one_call(link: Link, vehicle: FakeVehicle) -> None:
    values = parameters.read_parameters(link, ("THR_MDL_FAC", "NO_SUCH_THING"))
    assert values["THR_MDL_FAC"].value == pytest.approx(0.25)
    assert values["NO_SUCH_THING"].value is None
