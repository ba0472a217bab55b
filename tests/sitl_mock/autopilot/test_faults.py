"""Timed faults of a scenario: each begins, shows on the wire, and ends."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from dynamics.errors import RequestError
from sitl_mock.autopilot.fault_schedule import Fault
from sitl_mock.wire.dialect import mavlink
from tests.support.bench import ARM, LAND, SET_MODE, Bench

KINDS = ("ODOMETRY", "ATTITUDE", "LOCAL_POSITION_NED")


def bench_with(kind: str, **fields: object) -> Bench:
    return Bench(faults=(Fault(kind=kind, at=1.0, **fields),))


def messages_of(bench: Bench, seconds: float, kind: str = "ODOMETRY") -> list[object]:
    before = len(bench.of(kind))
    bench.run(seconds)
    return bench.of(kind)[before:]


def test_an_estimator_reset_jumps_and_counts() -> None:
    bench = bench_with("estimator_reset", shift=(2.0, 0.0, 0.0), yaw=0.5)
    before, after = messages_of(bench, 0.9)[-1], messages_of(bench, 0.3)[-1]
    assert after.y - before.y == pytest.approx(2.0)
    assert after.reset_counter == before.reset_counter + 1


def test_an_estimate_moves_without_a_word_and_back() -> None:
    bench = bench_with("estimate_move", shift=(2.0, 0.0, 0.0), duration=0.5)
    before, during, after = messages_of(bench, 0.9)[-1], messages_of(bench, 0.3)[-1], messages_of(bench, 0.5)[-1]
    assert during.y - before.y == pytest.approx(2.0, abs=0.2)
    assert after.y - before.y == pytest.approx(0.0, abs=0.2)
    assert before.reset_counter == during.reset_counter == after.reset_counter


def test_estimates_are_stamped_ahead_of_the_clock() -> None:
    bench = bench_with("stamps_ahead", seconds=3.0, duration=0.5)
    bench.run(1.2)
    lead = 1e-6 * (bench.of("ODOMETRY")[-1].time_usec - bench.of("HIGHRES_IMU")[-1].time_usec)
    assert lead == pytest.approx(3.0, abs=0.1)
    bench.run(0.5)
    lead = 1e-6 * (bench.of("ODOMETRY")[-1].time_usec - bench.of("HIGHRES_IMU")[-1].time_usec)
    assert lead == pytest.approx(0.0, abs=0.1)


def test_a_reboot_disarms_silences_the_link_and_starts_the_clock_again() -> None:
    bench = bench_with("reboot", duration=1.0)
    bench.run(0.8)
    assert bench.request(ARM, 1) == 0
    bench.run(0.4)
    assert not bench.mock.commander.armed
    heard = len(bench.heard)
    bench.run(0.3)
    assert len(bench.heard) == heard
    bench.run(1.5)
    assert bench.of("HIGHRES_IMU")[-1].time_usec < 2.5e6


def test_an_estimate_turns_to_nan_and_comes_back() -> None:
    bench = bench_with("estimate_nan", duration=1.0)
    bench.run(1.1)
    during, after = messages_of(bench, 0.5), messages_of(bench, 1.0)
    assert all(math.isnan(message.x) and math.isnan(message.q[0]) for message in during)
    assert during
    assert math.isfinite(after[-1].x)


def test_every_stream_survives_an_estimate_of_nan() -> None:
    bench = bench_with("estimate_nan")
    bench.run(3.0)
    assert bench.of("HEARTBEAT")[-1].custom_mode
    assert messages_of(bench, 0.5, "SYS_STATUS")[-1].onboard_control_sensors_health & 1 == 0


def test_a_frozen_estimate_stays_constant_while_its_time_advances() -> None:
    bench = bench_with("estimate_freeze", duration=1.0)
    bench.vehicle.velocity = np.array([1.0, 0.0, 0.0])
    bench.vehicle.position = np.array([0.0, 0.0, 50.0])
    bench.run(1.1)
    during = messages_of(bench, 0.5)
    assert len({message.y for message in during}) == 1
    assert during[-1].time_usec > during[0].time_usec
    bench.run(0.5)
    assert len({message.y for message in messages_of(bench, 0.5)}) > 5


def test_a_stopped_estimator_sends_no_estimate_but_the_rest() -> None:
    bench = bench_with("estimate_stop", duration=1.0)
    bench.run(1.1)
    assert not messages_of(bench, 0.8)
    assert messages_of(bench, 1.0)
    assert len(bench.of("HIGHRES_IMU")) > 100


def test_the_clock_jumps_backwards() -> None:
    bench = bench_with("clock_jump", seconds=-2.0)
    before, after = messages_of(bench, 0.9, "SYSTEM_TIME"), messages_of(bench, 1.5)
    assert before
    stamps = np.array([message.time_usec for message in bench.of("ODOMETRY")]) * 1e-6
    assert after
    assert np.diff(stamps).min() == pytest.approx(-2.0, abs=0.1)


def test_a_link_that_is_down_passes_nothing_either_way() -> None:
    bench = bench_with("link_down", duration=1.0)
    bench.run(1.1)
    before = len(bench.heard)
    bench.command(ARM, 1)
    bench.run(0.8)
    assert len(bench.heard) == before
    assert not bench.mock.commander.armed
    bench.run(0.5)
    assert len(bench.heard) > before


def test_packets_are_lost_with_the_faults_probability() -> None:
    bench = bench_with("packet_loss", probability=0.3)
    bench.run(1.0)
    before = len(bench.heard)
    assert len(messages_of(bench, 10.0, "ATTITUDE")) == pytest.approx(700, abs=60)
    numbers = np.array([int(message.get_msgbuf()[4]) for _, message in bench.heard[before:]])
    assert (np.diff(numbers) % 256 > 1).mean() == pytest.approx(0.3, abs=0.05)  # the gaps by which a client knows


def test_packets_are_duplicated() -> None:
    bench = bench_with("packet_duplication", probability=0.5)
    bench.run(1.0)
    messages = messages_of(bench, 5.0, "ATTITUDE")
    assert len(messages) == pytest.approx(750, abs=60)
    numbers = [message.get_seq() for message in messages]
    same = sum(a == b for a, b in itertools.pairwise(message.get_msgbuf()[4] for _, message in bench.heard[-1000:]))
    assert same > 200
    assert len(set(numbers)) > 100


def test_packets_are_reordered() -> None:
    bench = bench_with("packet_reorder", probability=0.3)
    bench.run(1.0)
    stamps = np.array([message.time_boot_ms for message in messages_of(bench, 5.0, "ATTITUDE")])
    assert len(stamps) == pytest.approx(500, abs=5)
    assert (np.diff(stamps) < 0).sum() > 20


def test_a_flood_adds_messages_at_its_rate_and_ends() -> None:
    bench = bench_with("message_flood", rate=2000.0, duration=1.0)
    bench.run(1.0)
    assert len(messages_of(bench, 1.0, "DEBUG")) == pytest.approx(2000, abs=50)
    bench.run(0.1)
    assert not messages_of(bench, 0.5, "DEBUG")


def test_arming_and_offboard_can_be_refused() -> None:
    bench = bench_with("refuse_arming", duration=1.0)
    bench.run(1.1)
    assert bench.request(ARM, 1) == 1
    bench.run(1.0)
    assert bench.request(ARM, 1) == 0
    bench = bench_with("refuse_offboard")
    bench.run(1.1)
    assert bench.request(SET_MODE, 1, 6) == 1


def test_a_fault_can_wait_for_the_take_off() -> None:
    bench = Bench(faults=(Fault(kind="estimate_nan", at=0.5, after="takeoff"),))
    bench.run(5.0)
    assert math.isfinite(bench.of("ODOMETRY")[-1].x)
    bench.fly()
    bench.stream(1.0, thrust=0.5)
    assert math.isnan(bench.of("ODOMETRY")[-1].x)


def test_overlapping_faults_end_one_by_one() -> None:
    faults = (Fault(kind="packet_loss", at=0.5, duration=1.0), Fault(kind="estimate_nan", at=1.0, duration=1.0))
    bench = Bench(faults=faults)
    bench.run(1.7)
    assert bench.link.fault.loss == 0.0
    assert bench.mock.estimate_fault.invalid
    bench.run(0.5)
    assert not bench.mock.estimate_fault.invalid


def test_unsolicited_ping_is_answered() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_ping_message(5, 6, 0, 0))
    bench.run(0.01)
    assert [(ping.time_usec, ping.seq) for ping in bench.of("PING")] == [(5, 6)]


def test_without_a_position_it_is_nan_and_comes_back_by_a_reset() -> None:
    bench = bench_with("gnss_loss", duration=2.0)
    before = messages_of(bench, 0.9)[-1]
    bench.run(1.2)
    lost = messages_of(bench, 0.5)[-1]
    assert math.isnan(lost.x)
    assert math.isnan(lost.vy)
    assert math.isfinite(lost.z)
    assert not bench.of("ESTIMATOR_STATUS")[-1].flags & (2 | 16)
    back = messages_of(bench, 1.0)[-1]
    assert math.isfinite(back.x)
    assert back.reset_counter == before.reset_counter + 1


def test_a_mode_that_needs_a_position_becomes_a_landing_without_one() -> None:
    bench = Bench(faults=(Fault(kind="gnss_loss", at=1.0, after="takeoff"),))
    bench.fly(2.0)
    bench.until(lambda: bench.heartbeat.custom_mode == LAND)  # the stream ended, and there is nowhere to return to
    bench.until(lambda: not bench.heartbeat.base_mode & 128)


def test_a_hand_holds_for_as_long_as_the_fault_lasts() -> None:
    bench = bench_with("held", duration=0.5)
    bench.run(1.1)
    assert bench.vehicle.held
    bench.run(0.5)
    assert not bench.vehicle.held


def test_a_fault_may_wait_for_the_contact_after_flight() -> None:
    bench = Bench(faults=(Fault(kind="estimate_freeze", at=0.0, after="touchdown"),))
    bench.fly()
    assert not bench.mock.estimate_fault.frozen
    assert bench.request(SET_MODE, 1, 4, 6) == 0
    bench.until(lambda: bench.vehicle.on_ground)
    bench.run(0.1)
    assert bench.mock.estimate_fault.frozen


def test_an_estimate_drifts_as_far_as_it_is_to_and_stays_there() -> None:
    bench = bench_with("estimate_drift", duration=1.0, shift=(0.0, 0.5, 0.7))
    bench.run(1.5)
    half = bench.of("ODOMETRY")[-1]
    bench.run(1.5)
    last = bench.of("ODOMETRY")[-1]
    assert half.x == pytest.approx(0.25, abs=0.03)
    assert (last.x, last.y, last.z) == pytest.approx((0.5, 0.0, -0.7), abs=0.01)
    assert last.reset_counter == half.reset_counter


def test_a_drift_needs_its_duration() -> None:
    with pytest.raises(RequestError, match="estimate_drift: wanted the duration"):
        bench_with("estimate_drift")
