"""What happens when setpoints stop, and when they come back."""

from __future__ import annotations

import pytest

from sitl_mock.wire.dialect import mavlink
from tests.support.bench import ARM, HOLD, LAND, OFFBOARD, RTL, SET_MODE, Bench

CRITICAL = 5


@pytest.mark.parametrize("seed", range(5))
def test_the_mode_changes_just_after_the_loss_time(seed: int) -> None:
    bench = Bench(seed=seed)
    bench.fly()
    bench.setpoint(0.5)
    lost = bench.until(lambda: bench.heartbeat.custom_mode != OFFBOARD)
    assert 1.02 - 0.004 <= lost <= 1.12 + 0.004
    assert bench.heartbeat.custom_mode == RTL
    assert bench.heartbeat.system_status == CRITICAL
    bench.run(1.1)
    assert bench.of("HEARTBEAT")[-1].system_status == CRITICAL


def test_the_loss_time_is_a_parameter() -> None:
    bench = Bench(parameters={"COM_OF_LOSS_T": 0.3})
    bench.fly()
    bench.setpoint(0.5)
    assert 0.31 <= bench.until(lambda: bench.heartbeat.custom_mode != OFFBOARD) <= 0.43


@pytest.mark.parametrize(("action", "mode"), [(0, RTL), (1, RTL), (2, RTL), (3, RTL), (4, LAND), (5, HOLD)])
def test_the_action_follows_its_parameter(action: int, mode: int) -> None:
    bench = Bench(parameters={"COM_OBL_RC_ACT": action})
    bench.fly()
    bench.until(lambda: bench.heartbeat.custom_mode != OFFBOARD)
    assert bench.heartbeat.custom_mode == mode
    assert bench.heartbeat.system_status == CRITICAL


def test_action_6_terminates_and_7_disarms() -> None:
    bench = Bench(parameters={"COM_OBL_RC_ACT": 6})
    bench.fly()
    bench.until(lambda: bench.heartbeat.system_status == 8)
    bench.run(0.01)
    assert not bench.vehicle.armed
    bench = Bench(parameters={"COM_OBL_RC_ACT": 7})
    bench.fly()
    bench.until(lambda: not bench.heartbeat.base_mode & 128)


@pytest.mark.parametrize("seed", range(5))
def test_offboard_returns_by_itself_when_the_stream_resumes(seed: int) -> None:
    bench = Bench(seed=seed)
    bench.fly()
    bench.until(lambda: bench.heartbeat.custom_mode == RTL)
    bench.run(1.0)
    bench.setpoint(0.5)
    back = bench.until(lambda: bench.heartbeat.custom_mode == OFFBOARD)
    assert 0.004 <= back <= 0.023
    assert bench.heartbeat.system_status == 4


def test_a_slow_stream_flips_the_mode_every_period() -> None:
    bench = Bench()
    bench.fly()
    flips = 0
    last = bench.heartbeat.custom_mode
    for _ in range(6):
        bench.setpoint(0.5)
        for _ in range(312):
            bench.run(0.004)
            flips += bench.heartbeat.custom_mode != last
            last = bench.heartbeat.custom_mode
    assert flips >= 10


def test_a_mask_with_nothing_usable_does_not_keep_offboard_alive() -> None:
    bench = Bench()
    bench.fly()
    bench.stream(1.5, thrust=0.5, mask=7 + 128)
    assert bench.heartbeat.custom_mode == RTL


def test_a_setpoint_of_nan_keeps_offboard_alive() -> None:
    bench = Bench()
    bench.fly(height=2.0)
    bench.stream(1.5, thrust=0.5, q=[float("nan")] * 4)
    assert bench.heartbeat.custom_mode == OFFBOARD


def test_a_companions_heartbeat_that_stops_changes_no_mode() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    bench.fly()
    bench.stream(6.0, thrust=0.5)
    assert bench.heartbeat.custom_mode == OFFBOARD


def test_another_mode_requested_during_the_failsafe_is_final() -> None:
    bench = Bench()
    bench.fly()
    bench.until(lambda: bench.heartbeat.custom_mode == RTL)
    assert bench.request(SET_MODE, 1, 4, 3) == 0
    bench.stream(0.5, thrust=0.5)
    assert bench.heartbeat.custom_mode == HOLD
    assert bench.heartbeat.system_status == 4


def test_the_mode_before_landing_is_back_after_disarming() -> None:
    bench = Bench()
    bench.fly()
    assert bench.request(SET_MODE, 1, 4, 6) == 0
    bench.until(lambda: not bench.heartbeat.base_mode & 128)
    assert bench.heartbeat.custom_mode == OFFBOARD


def test_arming_force_without_a_stream_ends_in_the_failsafe() -> None:
    bench = Bench()
    bench.request(SET_MODE, 1, 6)
    assert bench.request(ARM, 1, 21196) == 0
    bench.run(0.2)
    assert bench.heartbeat.custom_mode == RTL
