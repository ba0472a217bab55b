"""When PX4 arms, disarms and changes mode, and what it answers, observed from outside on a vehicle that stays down."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from simulation.mock_process import mock_process
from tests.conformance.raw_link import HOLD, LAND, OFFBOARD, SET_MODE, RawLink, attitude_target

pytestmark = pytest.mark.realtime

ACCEPTED, TEMPORARILY_REJECTED = 0, 1
ARMED = 128
IDLE = attitude_target(0.0)


@pytest.fixture(autouse=True)
def on_the_ground(link: RawLink) -> Iterator[None]:
    """Each test begins and ends disarmed in HOLD."""
    yield
    assert link.disarm() == ACCEPTED
    assert link.set_mode(HOLD) == ACCEPTED


def test_disarmed_offboard_is_accepted_and_shown_but_does_not_arm_without_a_stream(link: RawLink) -> None:
    assert link.set_mode(OFFBOARD) == ACCEPTED
    beat = link.state()
    assert (beat.custom_mode, beat.system_status) == (OFFBOARD, 0)
    assert link.arm() == TEMPORARILY_REJECTED
    assert not link.state().base_mode & ARMED


def test_armed_in_hold_offboard_is_refused_without_a_stream(link: RawLink) -> None:
    assert link.arm() == ACCEPTED
    assert link.set_mode(OFFBOARD) == TEMPORARILY_REJECTED
    assert link.state().custom_mode == HOLD


def test_one_setpoint_30_ms_earlier_is_enough(link: RawLink) -> None:
    link.arm()
    link.send(IDLE)
    time.sleep(0.03)
    assert link.set_mode(OFFBOARD) == ACCEPTED
    assert link.state().custom_mode == OFFBOARD


def test_a_stream_arms_at_once_in_offboard(link: RawLink) -> None:
    assert link.set_mode(OFFBOARD) == ACCEPTED
    with link.setpoints(lambda _: IDLE, 0.2):
        time.sleep(0.3)
        assert link.arm() == ACCEPTED
        beat = link.state()
        assert (beat.custom_mode, beat.base_mode, beat.system_status) == (OFFBOARD, 145, 4)


@pytest.mark.slow
def test_the_documented_rule_wants_more_than_2_hz_for_more_than_a_second() -> None:
    with mock_process("--offboard-rule", "documented") as mock, RawLink(mock.port) as link:
        assert link.set_mode(OFFBOARD) == ACCEPTED
        with link.setpoints(lambda _: IDLE, 0.7):
            time.sleep(2.2)
            assert link.arm() == TEMPORARILY_REJECTED
        with link.setpoints(lambda _: IDLE, 0.2):
            time.sleep(1.5)
            assert link.arm() == ACCEPTED


def test_arming_while_armed_is_accepted(link: RawLink) -> None:
    assert [link.arm(), link.arm()] == [ACCEPTED, ACCEPTED]


@pytest.mark.parametrize("main", [0, 9, 99])
def test_an_unknown_main_mode_is_temporarily_rejected(link: RawLink, main: int) -> None:
    assert link.result(SET_MODE, 1, main) == TEMPORARILY_REJECTED
    assert link.state().custom_mode == HOLD


def test_another_systems_commands_are_not_answered(link: RawLink) -> None:
    with pytest.raises(AssertionError, match="no such COMMAND_ACK"):
        link.command(400, 1, target=(2, 1), within=0.5)
    assert not link.state().base_mode & ARMED


def test_land_on_the_ground_is_a_mode_in_which_it_does_not_arm(link: RawLink) -> None:
    assert link.set_mode(LAND) == ACCEPTED
    assert link.arm() == TEMPORARILY_REJECTED


def test_the_first_motor_command_follows_arming_within_70_ms_and_lift_off_within_half_a_second(link: RawLink) -> None:
    link.set_rate(36, 250.0)
    link.set_rate(32, 250.0)
    link.set_mode(OFFBOARD)
    with link.setpoints(lambda _: attitude_target(0.75)) as stream:
        time.sleep(1.3)
        height = link.newest("LOCAL_POSITION_NED").z
        sent = time.monotonic()
        assert link.arm() == ACCEPTED
        started, _ = link.wait_for("SERVO_OUTPUT_RAW", lambda outputs: outputs.servo1_raw > 1300, since=sent)
        risen, _ = link.wait_for("LOCAL_POSITION_NED", lambda here: here.z < height - 0.03, since=sent)
        stream.make = lambda _: attitude_target(0.3)
        assert 0.015 < started - sent < 0.2  # 20 to 68 ms and the way there and back on a busy machine
        assert 0.15 < risen - sent < 0.6
        link.wait_for("EXTENDED_SYS_STATE", lambda state: state.landed_state == 2)
        assert link.disarm() == TEMPORARILY_REJECTED
        assert link.disarm(force=True) == ACCEPTED
        assert not link.state().base_mode & ARMED
    link.wait_for("EXTENDED_SYS_STATE", lambda state: state.landed_state == 1)


@pytest.mark.slow
def test_both_older_answers_to_a_mode_can_be_had() -> None:
    with mock_process("--double-ack") as mock, RawLink(mock.port) as link:
        for mode, verdict in ((OFFBOARD, ACCEPTED), (99 << 16, TEMPORARILY_REJECTED)):
            start = time.monotonic()
            assert link.set_mode(mode) == ACCEPTED
            time.sleep(0.15)
            (first, one), (second, two) = link.since(start, "COMMAND_ACK")
            assert [one.result, two.result] == [ACCEPTED, verdict]
            assert second - first < 0.05
        link.send(IDLE)  # one setpoint 30 ms earlier was enough on that version
        time.sleep(0.03)
        assert link.arm() == ACCEPTED


@pytest.mark.slow
def test_a_vehicle_that_does_not_take_off_disarms_itself_after_ten_seconds() -> None:
    with mock_process("--speed", "5") as mock, RawLink(mock.port) as link, link.watching_mode():
        armed = link.newest("ATTITUDE").time_boot_ms
        assert link.arm() == ACCEPTED
        link.wait_for("HEARTBEAT", lambda beat: beat.base_mode & ARMED != 0)
        link.wait_for("HEARTBEAT", lambda beat: not beat.base_mode & ARMED)
        assert (link.newest("ATTITUDE").time_boot_ms - armed) * 1e-3 == pytest.approx(10.0, abs=0.5)
