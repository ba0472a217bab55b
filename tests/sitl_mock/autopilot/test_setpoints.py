"""The type mask table of SET_ATTITUDE_TARGET, and SET_POSITION_TARGET_LOCAL_NED."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dynamics.quaternion import from_euler
from sitl_mock.autopilot.offboard import OffboardStream, attitude_target, global_position_target, position_target
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
from sitl_mock.wire.dialect import mavlink
from tests.support.bench import OFFBOARD, Bench

ROLLED = [math.cos(0.1), math.sin(0.1), 0.0, 0.0]  # FRD: right side down
LEVEL_EAST = from_euler(0.0, 0.0, 0.0)


def target(mask: int, *, q: object = ROLLED, rates: tuple[float, ...] = (0.1, 0.2, 0.3), thrust: float = 0.6):
    return attitude_target(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, q, *rates, thrust))


def position(mask: int, frame: int = 1, *, xyz=(1.0, 2.0, -3.0), v=(0.1, 0.2, 0.3), yaw: float = 0.0):
    message = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, *xyz, *v, 0.0, 0.0, 0.0, yaw, 0.0
    )
    return position_target(message, LEVEL_EAST)


def test_mask_7_is_attitude_and_thrust_without_rates() -> None:
    setpoint = target(7)
    assert (setpoint.kind, setpoint.thrust) == ("attitude", pytest.approx(0.6))
    assert setpoint.rate_body == pytest.approx([0, 0, 0])


def test_mask_3_adds_a_yaw_rate_feed_forward() -> None:
    setpoint = target(3)
    assert setpoint.kind == "attitude"
    assert setpoint.rate_body == pytest.approx([0, 0, -0.3])


def test_mask_128_is_body_rates_and_thrust() -> None:
    setpoint = target(128)
    assert (setpoint.kind, setpoint.thrust) == ("rates", pytest.approx(0.6))
    assert setpoint.rate_body == pytest.approx([0.1, -0.2, -0.3])


def test_mask_0_publishes_both_and_the_attitude_wins() -> None:
    assert target(0).kind == "attitude"


def test_an_ignored_throttle_is_zero_thrust_and_still_a_signal() -> None:
    assert target(7 + 64).thrust == 0.0
    assert target(128 + 64).thrust == 0.0


def test_mask_7_plus_128_is_no_offboard_signal() -> None:
    assert target(7 + 128) is None


@pytest.mark.parametrize("mask", [128 + 1, 128 + 2, 128 + 3])
def test_rates_count_only_with_roll_and_pitch(mask: int) -> None:
    assert target(mask) is None


def test_an_ignored_yaw_rate_leaves_the_other_axes() -> None:
    assert target(128 + 4).rate_body == pytest.approx([0.1, -0.2, math.nan], nan_ok=True)


def test_an_axis_may_have_position_where_the_others_have_speed() -> None:
    setpoint = position(1 | 2 | 32 | 448)
    assert setpoint.position_world == pytest.approx([math.nan, math.nan, 3.0], nan_ok=True)
    assert setpoint.velocity_world == pytest.approx([0.2, 0.1, math.nan], nan_ok=True)


def test_an_ignored_yaw_rate_is_not_a_number() -> None:
    assert np.isnan(target(128 + 4).rate_body[2])


def test_sign_and_length_of_the_quaternion_do_not_matter() -> None:
    usual = target(7).attitude
    longer = target(7, q=[5 * part for part in ROLLED]).attitude
    negative = target(7, q=[-part for part in ROLLED]).attitude
    assert longer == pytest.approx(usual)
    assert abs(float(negative @ usual)) == pytest.approx(1.0)


@pytest.mark.parametrize("q", [[math.nan] * 4, [0.0] * 4, [math.inf, 0, 0, 0]])
def test_a_setpoint_that_is_no_attitude_counts_as_alive_and_removes_control(q: list[float]) -> None:
    setpoint = target(7, q=q)
    assert setpoint is not None
    assert setpoint.kind == "rates"
    assert np.isnan(setpoint.rate_body).all()


def test_thrust_is_not_clamped_at_the_input() -> None:
    assert target(7, thrust=1.7).thrust == pytest.approx(1.7)
    assert target(7, thrust=-0.3).thrust == pytest.approx(-0.3)
    assert target(7, thrust=math.nan).thrust == 0.0


@pytest.mark.parametrize(
    ("system", "component", "counts"), [(1, 1, True), (0, 0, True), (2, 1, False), (1, 42, False), (0, 1, True)]
)
def test_only_setpoints_for_this_vehicle_or_for_all_count(system: int, component: int, counts: bool) -> None:
    bench = Bench()
    bench.setpoint(system=system, component=component)
    assert (bench.mock.commander.offboard.count == 1) is counts


def test_an_ignored_throttle_makes_the_vehicle_fall() -> None:
    bench = Bench()
    bench.fly(height=3.0)
    bench.stream(0.5, thrust=0.5, mask=7 + 64)
    assert bench.vehicle.velocity[2] == pytest.approx(-9.81 * 0.5, abs=0.3)
    assert bench.heartbeat.custom_mode == OFFBOARD


def test_position_and_velocity_targets_are_offboard_signals() -> None:
    setpoint = position(0b110111111000)
    assert setpoint.kind == "hold"
    assert setpoint.position_world == pytest.approx([2.0, 1.0, 3.0])
    assert np.isnan(setpoint.velocity_world).all()
    setpoint = position(0b110111000111)
    assert setpoint.velocity_world == pytest.approx([0.2, 0.1, -0.3], abs=1e-6)
    assert np.isnan(setpoint.position_world).all()


def test_yaw_of_a_position_target_is_counted_from_north_clockwise() -> None:
    assert position(0b100111111000, yaw=0.3).yaw == pytest.approx(math.pi / 2 - 0.3)


def test_body_velocity_is_turned_by_the_heading() -> None:
    setpoint = position(0b110111000111, frame=8, v=(1.0, 0.0, 0.0))
    assert setpoint.velocity_world == pytest.approx([1.0, 0.0, 0.0], abs=1e-6)  # the vehicle looks east


@pytest.mark.parametrize(("mask", "frame"), [(0b111111111111, 1), (0, 3), (512, 1)])
def test_a_position_target_with_nothing_usable_is_no_signal(mask: int, frame: int) -> None:
    assert position(mask, frame) is None


def test_global_positions_are_offboard_signals_too() -> None:
    message = mavlink.MAVLink_set_position_target_global_int_message(
        0, 1, 1, 5, 0b110111111000, 473977428, 85455967 + 1000, 499.0, *[0.0] * 8
    )
    setpoint = global_position_target(message)
    assert setpoint.position_world == pytest.approx([7.527, 0.0, 10.0], abs=0.01)


def test_the_documented_rule_requires_two_hertz_for_a_second() -> None:
    stream = OffboardStream("documented")
    for number in range(20):
        stream.feed(number * 0.1, ControlSetpoint("idle"))
        assert stream.may_begin(number * 0.1 + 0.01, 1.0) is (number > 9)
    slow = OffboardStream("documented")
    for number in range(20):
        slow.feed(number * 0.6, ControlSetpoint("idle"))
        assert not slow.may_begin(number * 0.6 + 0.01, 1.0)


def test_the_measured_rule_requires_one_setpoint() -> None:
    stream = OffboardStream("measured")
    assert not stream.may_begin(0.0, 1.0)
    stream.feed(0.0, ControlSetpoint("idle"))
    assert stream.may_begin(0.03, 1.0)
    assert not stream.may_begin(1.5, 1.0)
