"""The parameter protocol: byte-wise integers, the second announcement, PARAM_ERROR, and parameters that act."""

from __future__ import annotations

import math
import struct

import pytest

from dynamics.errors import RequestError
from sitl_mock.autopilot.parameters import Parameters
from sitl_mock.wire.dialect import mavlink
from tests.support.bench import Bench

INT32, REAL32 = 6, 9


def as_float(number: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", number))[0])


def as_integer(value: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


def read(bench: Bench, name: str = "", index: int = -1) -> None:
    bench.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), index))
    bench.run(0.004)


def write(bench: Bench, name: str, value: float, kind: int) -> None:
    bench.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))


def test_a_float_is_read_by_name() -> None:
    bench = Bench()
    read(bench, "COM_OF_LOSS_T")
    (value,) = bench.of("PARAM_VALUE")
    assert (value.param_id, value.param_value, value.param_type) == ("COM_OF_LOSS_T", 1.0, REAL32)


def test_an_integer_travels_byte_wise() -> None:
    bench = Bench(parameters={"SYS_AUTOSTART": 10040})
    read(bench, "SYS_AUTOSTART")
    (value,) = bench.of("PARAM_VALUE")
    assert value.param_type == INT32
    assert as_integer(value.param_value) == 10040


def test_a_parameter_is_read_by_index() -> None:
    bench = Bench()
    read(bench, "COM_OBL_RC_ACT")
    index = bench.of("PARAM_VALUE")[-1].param_index
    read(bench, index=index)
    assert bench.of("PARAM_VALUE")[-1].param_id == "COM_OBL_RC_ACT"


def test_the_list_holds_every_parameter_once() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_param_request_list_message(1, 1))
    bench.run(1.0)
    values = bench.of("PARAM_VALUE")
    assert [value.param_index for value in values] == list(range(values[0].param_count))
    assert len({value.param_id for value in values}) == len(values)


def test_a_change_is_announced_twice() -> None:
    bench = Bench()
    sent = bench.time
    write(bench, "COM_OF_LOSS_T", 0.5, REAL32)
    bench.run(0.1)
    first, second = bench.times("PARAM_VALUE")
    assert first - sent <= 0.005
    assert 0.014 <= second - first <= 0.023
    assert [value.param_value for value in bench.of("PARAM_VALUE")] == [0.5, 0.5]


def test_writing_the_same_value_is_announced_once() -> None:
    bench = Bench()
    write(bench, "COM_OBL_RC_ACT", as_float(0), INT32)
    bench.run(0.1)
    assert len(bench.of("PARAM_VALUE")) == 1


def test_a_change_of_one_link_is_announced_on_the_others_too() -> None:
    bench = Bench()
    other = bench.mock.add_link("other", "gcs")
    write(bench, "COM_OBL_RC_ACT", as_float(5), INT32)
    bench.run(0.1)
    assert any(b"COM_OBL_RC_ACT" in frame for frame in other.take(bench.time))


@pytest.mark.parametrize("index", [-1, 20000])
def test_an_unknown_parameter_is_an_error_and_no_value(index: int) -> None:
    bench = Bench()
    read(bench, "NO_SUCH_PARAM", index)
    (error,) = bench.of("PARAM_ERROR")
    assert (error.error, error.target_system, error.target_component) == (1, 1, 191)
    assert not bench.of("PARAM_VALUE")


def test_writing_an_unknown_parameter_is_an_error() -> None:
    bench = Bench()
    write(bench, "NO_SUCH_PARAM", 1.0, REAL32)
    bench.run(0.1)
    assert [error.param_id for error in bench.of("PARAM_ERROR")] == ["NO_SUCH_PARAM"]
    assert not bench.of("PARAM_VALUE")


@pytest.mark.parametrize(
    ("name", "value", "kind"),
    [("COM_OF_LOSS_T", 1.0, INT32), ("COM_OBL_RC_ACT", 5.0, REAL32), ("THR_MDL_FAC", math.nan, 9)],
)
def test_a_wrong_type_or_no_number_is_an_error_and_changes_nothing(name: str, value: float, kind: int) -> None:
    bench = Bench()
    before = bench.mock.parameters[name]
    write(bench, name, value, kind)
    bench.run(0.1)
    assert len(bench.of("PARAM_ERROR")) == 1
    assert bench.mock.parameters[name] == before


def test_parameters_of_another_system_are_left_alone() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_param_set_message(2, 1, b"COM_OF_LOSS_T", 0.5, REAL32))
    bench.run(0.1)
    assert not bench.of("PARAM_VALUE")
    assert bench.mock.parameters["COM_OF_LOSS_T"] == 1.0


def test_gains_written_over_the_link_reach_the_inner_loops() -> None:
    bench = Bench()
    write(bench, "MC_ROLL_P", 6.5, REAL32)
    write(bench, "MC_YAWRATE_MAX", 90.0, REAL32)
    write(bench, "THR_MDL_FAC", 0.3, REAL32)
    assert bench.vehicle.tuning.attitude_gain[0] == 6.5
    assert bench.vehicle.tuning.rate_limit[2] == pytest.approx(math.pi / 2)
    assert bench.vehicle.tuning.thrust_model_factor == pytest.approx(0.3)


def test_hover_thrust_does_not_scale_offboard_thrust() -> None:
    bench = Bench()
    write(bench, "MPC_THR_HOVER", 0.3, REAL32)
    bench.fly()
    bench.stream(0.1, thrust=0.45)
    assert bench.vehicle.setpoint.thrust == pytest.approx(0.45)


def test_the_loss_action_can_be_changed_in_flight() -> None:
    bench = Bench()
    bench.fly()
    write(bench, "COM_OBL_RC_ACT", as_float(5), INT32)
    bench.until(lambda: bench.heartbeat.custom_mode == 4 << 16 | 3 << 24)


def test_the_system_id_is_a_parameter() -> None:
    bench = Bench(parameters={"MAV_SYS_ID": 7})
    bench.run(0.1)
    assert bench.of("HEARTBEAT")[0].get_srcSystem() == 7


def test_the_hash_changes_with_a_value() -> None:
    bench = Bench()
    read(bench, "_HASH_CHECK")
    write(bench, "MC_ROLL_P", 6.5, REAL32)
    read(bench, "_HASH_CHECK")
    hashes = [value.param_value for value in bench.of("PARAM_VALUE") if value.param_id == "_HASH_CHECK"]
    assert len(set(hashes)) == 2


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("COM_OF_LOS_T", 1.0, "did you mean COM_OF_LOSS_T"),
        ("COM_OBL_RC_ACT", 9, "0 to 7"),
        ("COM_OBL_RC_ACT", 1.5, "whole number"),
        ("THR_MDL_FAC", math.nan, "0 to 1"),
    ],
)
def test_an_impossible_parameter_is_refused_with_what_is_possible(name: str, value: float, message: str) -> None:
    with pytest.raises(RequestError, match=message):
        Parameters({name: value})
