"""ODOMETRY and its companions: frames, time stamps, continuity, reset counter, estimator resets."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.frames import attitude_enu_flu, enu_from_ned, flu_from_frd
from dynamics.quaternion import from_euler, rotate
from tests.support.bench import SET_INTERVAL, Bench

ODOMETRY = 331


def moving_bench(**behaviour: object) -> Bench:
    bench = Bench(**behaviour)
    bench.vehicle.position = np.array([1.0, 2.0, 3.0])
    bench.vehicle.velocity = np.array([0.5, -0.25, 0.0])
    bench.vehicle.attitude = from_euler(0.1, 0.2, 0.7)
    return bench


def test_odometry_is_ned_with_ned_velocity() -> None:
    bench = moving_bench()
    bench.run(0.2)
    odometry, truth = bench.of("ODOMETRY")[-1], bench.vehicle
    assert (odometry.frame_id, odometry.child_frame_id) == (1, 1)
    assert enu_from_ned([odometry.x, odometry.y, odometry.z])[:2] == pytest.approx(truth.position[:2], abs=0.02)
    assert enu_from_ned([odometry.vx, odometry.vy, odometry.vz])[:2] == pytest.approx([0.5, -0.25], abs=1e-3)
    attitude = attitude_enu_flu(odometry.q)
    assert abs(float(attitude @ truth.attitude)) == pytest.approx(1.0, abs=1e-6)


def test_velocity_can_be_body_frd_by_its_child_frame() -> None:
    bench = moving_bench(body_velocity=True)
    bench.run(0.2)
    odometry = bench.of("ODOMETRY")[-1]
    assert odometry.child_frame_id == 12
    velocity = rotate(bench.vehicle.attitude, flu_from_frd([odometry.vx, odometry.vy, odometry.vz]))
    assert velocity[:2] == pytest.approx([0.5, -0.25], abs=1e-3)


def test_local_position_and_attitude_agree_with_odometry() -> None:
    bench = moving_bench()
    bench.request(SET_INTERVAL, ODOMETRY, 4000)
    bench.run(0.5)
    odometry = {message.time_usec // 1000: message for message in bench.of("ODOMETRY")}
    local = [message for message in bench.of("LOCAL_POSITION_NED") if message.time_boot_ms in odometry]
    attitude = [message for message in bench.of("ATTITUDE_QUATERNION") if message.time_boot_ms in odometry]
    assert local
    assert attitude
    assert local[0].x == pytest.approx(odometry[local[0].time_boot_ms].x)
    assert [attitude[0].q1, attitude[0].q4] == pytest.approx(
        [odometry[attitude[0].time_boot_ms].q[0], odometry[attitude[0].time_boot_ms].q[3]]
    )


def test_quaternions_are_continuous_through_a_full_turn() -> None:
    bench = Bench()
    bench.fly()
    bench.request(SET_INTERVAL, ODOMETRY, 10_000)
    before = len(bench.of("ODOMETRY"))
    bench.stream(9.0, thrust=0.5, mask=128, rates=(0.0, 0.0, 1.5))
    attitudes = np.array([message.q for message in bench.of("ODOMETRY")[before:]])
    assert np.min(np.sum(attitudes[1:] * attitudes[:-1], axis=1)) > 0.99
    assert attitudes[:, 0].min() < -0.9
    assert attitudes[:, 0].max() > 0.9


def test_reset_counter_is_not_zero_at_take_off() -> None:
    counters = set()
    for seed in range(8):
        bench = Bench(seed=seed)
        bench.run(0.1)
        counters.add(bench.of("ODOMETRY")[-1].reset_counter)
    assert counters <= {9, 10, 11}


def test_an_estimator_reset_moves_the_estimate_and_counts() -> None:
    bench = moving_bench()
    bench.run(0.2)
    before = bench.of("ODOMETRY")[-1]
    assert bench.request(31010, 1.0, -2.0, 0.5, 0.3) == 0
    bench.run(0.1)
    after = bench.of("ODOMETRY")[-1]
    assert after.reset_counter == before.reset_counter + 1
    assert after.x - before.x == pytest.approx(1.0, abs=0.1)
    assert after.y - before.y == pytest.approx(-2.0, abs=0.1)
    turn = 2 * np.arccos(min(1.0, abs(np.dot(after.q, before.q))))
    assert turn == pytest.approx(0.3, abs=1e-3)


def test_a_setpoint_in_the_moved_frame_means_the_same_attitude() -> None:
    bench = Bench()
    bench.fly()
    bench.request(31010, 0.0, 0.0, 0.0, 0.4)
    turned = [np.cos(0.2), 0, 0, np.sin(0.2)]  # heading 0 of before is 0.4 rad of now
    bench.stream(0.1, thrust=0.5, q=turned)
    heading_before = attitude_enu_flu([1.0, 0, 0, 0])
    assert abs(float(bench.vehicle.attitude @ heading_before)) == pytest.approx(1.0, abs=1e-6)


def test_time_stamps_are_the_vehicles_clock() -> None:
    bench = Bench(clock_drift=0.01)
    bench.run(10.0)
    first, last = bench.of("ODOMETRY")[0], bench.of("ODOMETRY")[-1]
    arrived = bench.times("ODOMETRY")
    assert first.time_usec > 1_000_000  # it has been up for a while
    elapsed = (last.time_usec - first.time_usec) * 1e-6
    assert elapsed - (arrived[-1] - arrived[0]) == pytest.approx(0.1, abs=0.01)
