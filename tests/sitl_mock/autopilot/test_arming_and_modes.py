"""Arming, modes and their acknowledgements, as measured on PX4."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sitl_mock.wire.dialect import mavlink
from tests.support.bench import ARM, HOLD, LAND, OFFBOARD, RTL, SET_MODE, Bench

ACCEPTED, TEMPORARILY_REJECTED, UNSUPPORTED = 0, 1, 3
ARMED = 128


def test_offboard_without_a_stream_is_accepted_while_disarmed_but_arming_then_is_not() -> None:
    bench = Bench()
    assert bench.request(SET_MODE, 1, 6) == ACCEPTED
    assert bench.heartbeat.custom_mode == OFFBOARD
    assert bench.request(ARM, 1) == TEMPORARILY_REJECTED
    assert not bench.heartbeat.base_mode & ARMED


def test_offboard_is_refused_without_a_setpoint_stream_while_armed_in_hold() -> None:
    bench = Bench()
    assert bench.request(ARM, 1) == ACCEPTED
    assert bench.request(SET_MODE, 1, 6) == TEMPORARILY_REJECTED
    assert bench.heartbeat.custom_mode == HOLD


def test_offboard_is_taken_up_after_a_second_of_setpoints_by_the_documented_rule() -> None:
    bench = Bench(rule="documented")
    bench.request(ARM, 1)
    bench.stream(0.8)
    assert bench.request(SET_MODE, 1, 6) == TEMPORARILY_REJECTED
    bench.stream(0.4)
    assert bench.request(SET_MODE, 1, 6) == ACCEPTED
    assert bench.heartbeat.custom_mode == OFFBOARD


def test_one_setpoint_30_ms_earlier_is_enough() -> None:
    bench = Bench()
    bench.request(ARM, 1)
    bench.setpoint()
    bench.run(0.032)
    assert bench.request(SET_MODE, 1, 6) == ACCEPTED


def test_acknowledgements_come_within_16_ms_to_their_requester() -> None:
    bench = Bench()
    delays = []
    for _ in range(100):
        sent = bench.time
        bench.request(ARM, 1)
        delays.append(bench.times("COMMAND_ACK")[-1] - sent)
        assert (bench.of("COMMAND_ACK")[-1].target_system, bench.of("COMMAND_ACK")[-1].target_component) == (1, 191)
    assert min(delays) >= 0.0005
    assert 0.010 <= max(delays) <= 0.016


def test_the_double_acknowledgement_is_false_first_and_true_after() -> None:
    bench = Bench(double_ack=True)
    bench.request(ARM, 1)
    for _ in range(20):
        before = len(bench.of("COMMAND_ACK"))
        assert bench.request(SET_MODE, 1, 6) == TEMPORARILY_REJECTED
        assert [ack.result for ack in bench.of("COMMAND_ACK")[before:]] == [ACCEPTED, TEMPORARILY_REJECTED]
        first, second = bench.times("COMMAND_ACK")[before:]
        assert 0.0 <= second - first <= 0.008
    assert bench.heartbeat.custom_mode == HOLD


def test_there_is_one_acknowledgement_by_default() -> None:
    bench = Bench()
    bench.request(SET_MODE, 1, 4, 3)
    assert len(bench.of("COMMAND_ACK")) == 1


def test_the_ground_is_left_by_disarming_after_ten_seconds() -> None:
    bench = Bench()
    bench.request(ARM, 1)
    assert bench.until(lambda: not bench.heartbeat.base_mode & ARMED) == pytest.approx(10.0, abs=0.1)


def test_preflight_disarming_follows_its_parameter() -> None:
    bench = Bench(parameters={"COM_DISARM_PRFLT": 3.0})
    bench.request(ARM, 1)
    assert bench.until(lambda: not bench.heartbeat.base_mode & ARMED) == pytest.approx(3.0, abs=0.1)


def test_disarming_in_the_air_needs_force() -> None:
    bench = Bench()
    bench.fly()
    assert bench.request(ARM, 0) == TEMPORARILY_REJECTED
    assert bench.heartbeat.base_mode & ARMED
    assert bench.request(ARM, 0, 21196) == ACCEPTED
    assert not bench.heartbeat.base_mode & ARMED
    assert not bench.vehicle.armed


def test_arming_while_armed_and_disarming_while_disarmed_are_accepted() -> None:
    bench = Bench()
    assert bench.request(ARM, 0) == ACCEPTED
    assert bench.request(ARM, 1) == ACCEPTED
    assert bench.request(ARM, 1) == ACCEPTED


def test_disarming_on_the_ground_is_accepted() -> None:
    bench = Bench()
    bench.request(ARM, 1)
    assert bench.request(ARM, 0) == ACCEPTED
    assert not bench.heartbeat.base_mode & ARMED


@pytest.mark.parametrize(("main", "sub"), [(99, 0), (0, 0), (4, 77)])
def test_an_unknown_mode_is_temporarily_rejected(main: int, sub: int) -> None:
    bench = Bench()
    assert bench.request(SET_MODE, 1, main, sub) == TEMPORARILY_REJECTED
    assert bench.heartbeat.custom_mode == HOLD


@pytest.mark.parametrize(("sub", "custom"), [(3, HOLD), (5, RTL), (6, LAND)])
def test_custom_mode_is_main_and_sub_shifted(sub: int, custom: int) -> None:
    bench = Bench()
    assert bench.request(SET_MODE, 1, 4, sub) == ACCEPTED
    bench.run(1.1)
    assert bench.of("HEARTBEAT")[-1].custom_mode == custom


def test_set_mode_messages_do_the_same_as_the_command() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_set_mode_message(1, 1, OFFBOARD))
    assert bench.heartbeat.custom_mode == OFFBOARD
    bench.send(mavlink.MAVLink_set_mode_message(7, 1, HOLD))
    assert bench.heartbeat.custom_mode == OFFBOARD


@pytest.mark.parametrize(("system", "component", "answered"), [(1, 1, 1), (1, 0, 1), (2, 1, 0), (1, 50, 0)])
def test_only_commands_for_this_autopilot_are_answered(system: int, component: int, answered: int) -> None:
    bench = Bench()
    bench.command(SET_MODE, 1, 4, 3, system=system, component=component)
    bench.run(0.02)
    assert len(bench.of("COMMAND_ACK")) == answered


def test_an_unknown_command_is_unsupported() -> None:
    assert Bench().request(31999) == UNSUPPORTED


def test_command_int_is_understood_as_command_long() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_command_int_message(1, 1, 0, ARM, 0, 0, 1.0, 0, 0, 0, 0, 0, 0))
    assert bench.heartbeat.base_mode & ARMED


def test_motors_start_20_to_68_ms_after_arming() -> None:
    for seed in range(10):
        bench = Bench(seed=seed)
        bench.stream(1.2)
        bench.request(SET_MODE, 1, 6)
        bench.setpoint(0.4)
        bench.command(ARM, 1)
        assert 0.016 <= bench.until(lambda bench=bench: bench.vehicle.thrust > 0) <= 0.072


def test_heartbeat_of_the_recorded_px4() -> None:
    bench = Bench()
    bench.run(0.1)
    first = bench.of("HEARTBEAT")[0]
    assert (first.type, first.autopilot, first.base_mode, first.custom_mode) == (2, 12, 29, 50593792)
    assert first.system_status == 3
    bench.fly()
    flying = bench.heartbeat
    assert (flying.base_mode, flying.custom_mode, flying.system_status) == (145, OFFBOARD, 4)


def test_take_off_land_and_disarm_by_themselves() -> None:
    bench = Bench()
    assert bench.request(22) == ACCEPTED
    assert bench.request(ARM, 1) == ACCEPTED
    bench.until(lambda: bench.heartbeat.landed_state == 3)
    bench.until(lambda: bench.heartbeat.custom_mode == HOLD)
    assert bench.vehicle.position[2] == pytest.approx(2.5, abs=0.5)
    assert bench.request(21) == ACCEPTED
    assert bench.heartbeat.landed_state == 4
    bench.until(lambda: bench.heartbeat.landed_state == 1)
    assert bench.until(lambda: not bench.heartbeat.base_mode & ARMED) == pytest.approx(2.0, abs=0.1)
    assert bench.heartbeat.custom_mode == HOLD


def test_landed_state_goes_from_ground_to_air() -> None:
    bench = Bench()
    bench.run(0.5)
    assert bench.of("EXTENDED_SYS_STATE")[-1].landed_state == 1
    bench.fly()
    assert bench.of("EXTENDED_SYS_STATE")[-1].landed_state == 2


def test_arming_is_refused_in_modes_that_prevent_it_or_need_a_pilot() -> None:
    bench = Bench()
    for main, sub in ((4, 5), (4, 6), (1, 0), (3, 0)):
        assert bench.request(SET_MODE, 1, main, sub) == ACCEPTED
        assert bench.request(ARM, 1) == TEMPORARILY_REJECTED


def test_arming_is_refused_to_a_vehicle_that_has_tipped_over() -> None:
    bench = Bench()
    bench.vehicle.attitude = np.array([math.cos(1.41), math.sin(1.41), 0.0, 0.0])  # 162 degrees of roll
    bench.run(0.1)
    assert bench.request(ARM, 1) == TEMPORARILY_REJECTED
    bench.vehicle.attitude = np.array([1.0, 0.0, 0.0, 0.0])
    bench.run(0.1)
    assert bench.request(ARM, 1) == ACCEPTED


def test_termination_stops_the_rotors() -> None:
    bench = Bench()
    bench.fly()
    assert bench.request(185, 1) == ACCEPTED
    bench.stream(0.1, thrust=0.5)
    assert not bench.vehicle.armed
    assert bench.heartbeat.system_status == 8
