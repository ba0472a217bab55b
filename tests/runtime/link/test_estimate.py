"""Estimates come out in our frames whatever the message's, and what cannot be true is named and left out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from runtime.link.estimate import EstimateCheck, EstimateMonitor, StateEstimate
from runtime.link.odometry import Odometry, read_odometry
from tests.support.fake_vehicle import odometry

NORTH_EAST_DOWN_TO_EAST_NORTH_UP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FORWARD_RIGHT_DOWN_TO_FORWARD_LEFT_UP = np.diag([1.0, -1.0, -1.0])

vectors = st.tuples(*[st.floats(-20, 20)] * 3).map(np.array)
attitudes = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: np.array(q) / np.linalg.norm(q))
)


def read(**fields: Any) -> Odometry:
    message = odometry(**fields)
    packer = mavlink.MAVLink(None, 1, 1)
    data = bytes(message.pack(packer))
    return read_odometry(data[10:-2])


def feed(monitor: EstimateMonitor, time: float, *, offset: float = 0.0, **fields: Any) -> EstimateCheck:
    """A sample that is received 5 ms after its time. offset: s, of the vehicle's clock."""
    fields.setdefault("time_usec", round(1e6 * (time + offset)))
    return monitor.handle_odometry(read(**fields), time, time + 0.005, True)


def accepted(check: EstimateCheck | None) -> StateEstimate:
    assert check is not None
    assert check.estimate is not None, check
    return check.estimate


@pytest.fixture
def monitor() -> EstimateMonitor:
    return EstimateMonitor()


@given(vectors, vectors, vectors, attitudes)
def test_odometry_is_read_as_pymavlink_packed_it(
    position: Floats,
    velocity: Floats,
    rate: Floats,
    attitude: Floats,
) -> None:
    fields = (*position, *attitude, *velocity, *rate)
    names = ("x", "y", "z", "vx", "vy", "vz", "rollspeed", "pitchspeed", "yawspeed")
    values = dict(zip(names, (*position, *velocity, *rate), strict=True))
    result = read(time_usec=7_000_001, q=attitude.tolist(), child_frame_id=12, reset_counter=200, **values)
    assert result.time == pytest.approx(7.000001)
    assert result.wire == pytest.approx(fields, rel=1e-6, abs=1e-6)
    assert (result.frame_id, result.child_frame_id, result.reset_counter) == (1, 12, 200)


@given(vectors, vectors, vectors, attitudes)
def test_both_velocity_frames_give_the_same_state(
    position: Floats,
    velocity: Floats,
    rate: Floats,
    attitude: Floats,
) -> None:
    """Against matrices written out here, not the quaternions that the code uses."""
    body_to_ned = quaternion.rotation_matrix(attitude)
    velocity_body = body_to_ned.T @ velocity
    names = ("x", "y", "z", "vx", "vy", "vz", "rollspeed", "pitchspeed", "yawspeed")
    for child, wire_velocity in ((1, velocity), (12, velocity_body)):
        values = dict(zip(names, (*position, *wire_velocity, *rate), strict=True))
        estimate = accepted(feed(EstimateMonitor(), 1.0, q=attitude.tolist(), child_frame_id=child, **values))
        assert estimate.position_world == pytest.approx(NORTH_EAST_DOWN_TO_EAST_NORTH_UP @ position, abs=1e-4)
        assert estimate.velocity_world == pytest.approx(NORTH_EAST_DOWN_TO_EAST_NORTH_UP @ velocity, abs=1e-4)
        assert estimate.rate_body == pytest.approx(FORWARD_RIGHT_DOWN_TO_FORWARD_LEFT_UP @ rate, abs=1e-4)
        expected = NORTH_EAST_DOWN_TO_EAST_NORTH_UP @ body_to_ned @ FORWARD_RIGHT_DOWN_TO_FORWARD_LEFT_UP
        assert quaternion.rotation_matrix(estimate.attitude) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(("frame", "child"), [(20, 12), (4, 1), (1, 8), (1, 20), (99, 1), (1, 0)])
def test_unknown_axes_are_refused_by_name(monitor: EstimateMonitor, frame: int, child: int) -> None:
    check = feed(monitor, 1.0, frame_id=frame, child_frame_id=child)
    assert check.estimate is None
    assert check.event == "estimate_frame_refused"
    assert "required 1 (LOCAL_NED)" in check.text


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("field", ["x", "vz", "yawspeed"])
def test_what_is_not_finite_is_refused(monitor: EstimateMonitor, field: str, value: float) -> None:
    feed(monitor, 1.0)
    check = feed(monitor, 1.01, **{field: value})
    assert (check.estimate, check.event) == (None, "estimate_not_finite")
    assert accepted(feed(monitor, 1.02)).time == 1.02


@pytest.mark.parametrize("counter", [7, 8])
@pytest.mark.parametrize("field", ["x", "z", "vy"])
def test_what_no_vehicle_can_have_is_refused_however_long_it_lasts(
    monitor: EstimateMonitor, field: str, counter: int
) -> None:
    """A counted reset and a lasting jump make a position credible that a local frame can hold, and no other."""
    feed(monitor, 1.0, reset_counter=7)
    for tick in range(30):
        check = feed(monitor, 1.01 + 0.01 * tick, reset_counter=counter, **{field: 1e30})
        assert (check.estimate, check.step, check.event) == (None, None, "estimate_out_of_range")
    assert accepted(feed(monitor, 1.5, reset_counter=7)).time == 1.5


@pytest.mark.parametrize("attitude", [[0.0] * 4, [float("nan"), 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0]])
def test_what_is_no_rotation_is_refused(monitor: EstimateMonitor, attitude: list[float]) -> None:
    assert feed(monitor, 1.0, q=attitude).event == "estimate_not_finite"


def test_a_jump_is_refused_until_it_lasts(monitor: EstimateMonitor) -> None:
    feed(monitor, 1.0)
    first = feed(monitor, 1.01, x=3.0)
    assert (first.estimate, first.event) == (None, "estimate_jump")
    assert "position by 3.00 m" in first.text
    accepted(feed(monitor, 1.02))
    findings = [feed(monitor, 1.03 + 0.01 * n, x=3.0).event for n in range(11)]
    assert findings == ["estimate_jump"] * 9 + ["estimate_moved"] + [None]
    assert monitor.latest is not None
    assert monitor.latest.position_world[1] == pytest.approx(3.0)


def test_samples_that_jump_about_are_never_accepted(monitor: EstimateMonitor) -> None:
    feed(monitor, 1.0)
    findings = {feed(monitor, 1.0 + 0.01 * n, x=30.0 * (n % 5 + 1)).event for n in range(1, 80)}
    assert findings == {"estimate_jump"}


@pytest.mark.parametrize("change", [{"vx": 4.0}, {"q": [0.7071068, 0.7071068, 0.0, 0.0]}])
def test_velocity_and_attitude_may_not_jump_either(monitor: EstimateMonitor, change: dict[str, Any]) -> None:
    feed(monitor, 1.0)
    assert feed(monitor, 1.01, **change).event == "estimate_jump"


def test_fast_flight_is_not_a_jump(monitor: EstimateMonitor) -> None:
    """30 m/s with 4 g sideways and 10 rad/s of roll, at 50 Hz with noise of 3 cm."""
    random = np.random.default_rng(3)
    for n in range(200):
        time = 0.02 * n
        noise = random.normal(0.0, 0.03, 3)
        check = feed(
            monitor,
            10.0 + time,
            x=30.0 * time + noise[0],
            vx=30.0,
            y=20.0 * time**2 + noise[1],
            vy=40.0 * time,
            z=noise[2],
            q=[np.cos(5.0 * time), np.sin(5.0 * time), 0.0, 0.0],
            rollspeed=10.0,
        )
        accepted(check)


def test_a_reset_is_reported_with_its_step(monitor: EstimateMonitor) -> None:
    yaw = np.radians(90.0)
    feed(monitor, 1.0, vx=1.0, reset_counter=11)
    check = feed(
        monitor, 1.1, x=0.1, y=2.0, z=-1.0, vx=1.0, q=[np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)], reset_counter=12
    )
    assert check.event == "estimator_reset"
    assert check.step is not None
    assert check.step.position_world == pytest.approx([2.0, 0.0, 1.0], abs=1e-5)
    assert check.step.yaw == pytest.approx(-yaw, abs=1e-5)  # to the right is negative about up
    assert accepted(check).position_world == pytest.approx([2.0, 0.1, 1.0])


def test_a_reset_counter_that_starts_anywhere_is_no_reset(monitor: EstimateMonitor) -> None:
    assert feed(monitor, 1.0, reset_counter=11).event is None
    assert feed(monitor, 1.01, reset_counter=11).event is None


def test_time_running_backwards_is_reported_and_survived(monitor: EstimateMonitor) -> None:
    feed(monitor, 5.0)
    check = feed(monitor, 4.0)
    assert (check.estimate, check.event) == (None, "estimate_time_backwards")
    assert accepted(feed(monitor, 5.01)).time == 5.01


def test_a_sample_that_another_overtook_is_dropped_silently(monitor: EstimateMonitor) -> None:
    feed(monitor, 5.0)
    assert feed(monitor, 4.98) == EstimateCheck(None)
    assert accepted(feed(monitor, 5.01)).time == 5.01


def test_a_clock_filter_that_moves_back_is_no_clock_that_runs_backwards(monitor: EstimateMonitor) -> None:
    feed(monitor, 5.0)
    estimate = accepted(feed(monitor, 4.998, offset=0.012))  # 10 ms later by the vehicle's clock
    assert estimate.time == pytest.approx(5.003)  # not after its arrival
    assert accepted(feed(monitor, 5.012, offset=0.012)).time == 5.012


def test_samples_without_a_clock_are_ordered_by_their_arrival(monitor: EstimateMonitor) -> None:
    for time in (5.0, 5.01, 5.02):
        check = monitor.handle_odometry(read(time_usec=0), time, time, False)
        assert accepted(check).time == time
    assert accepted(feed(monitor, 5.0249)).is_synchronised  # from here on the vehicle's clock is followed


def test_the_same_sample_twice_is_dropped_silently(monitor: EstimateMonitor) -> None:
    feed(monitor, 5.0)
    assert feed(monitor, 5.0) == EstimateCheck(None)


def test_the_attitude_s_sign_never_jumps(monitor: EstimateMonitor) -> None:
    previous = None
    for n in range(400):
        half = 0.02 * n
        sign = -1.0 if n % 3 else 1.0
        attitude = [sign * np.cos(half), 0.0, 0.0, sign * np.sin(half)]
        estimate = accepted(feed(monitor, 1.0 + 0.01 * n, q=attitude, yawspeed=4.0))
        assert previous is None or float(estimate.attitude @ previous) > 0.99
        previous = estimate.attitude


def _local_position(**fields: float) -> Any:
    values = {"time_boot_ms": 0, "x": 0.0, "y": 0.0, "z": 0.0, "vx": 0.0, "vy": 0.0, "vz": 0.0, **fields}
    return mavlink.MAVLink_local_position_ned_message(**values)


def _attitude(attitude: Floats) -> Any:
    return mavlink.MAVLink_attitude_quaternion_message(0, *attitude.tolist(), 0.1, 0.2, 0.3)


def test_position_and_attitude_messages_stand_in_for_odometry(monitor: EstimateMonitor) -> None:
    attitude = quaternion.from_euler(0.1, -0.2, 1.0)
    assert monitor.handle_attitude(_attitude(attitude), 0.9, 0.9, True) is None
    monitor.handle_local_position(_local_position(x=1.0, y=2.0, z=-3.0, vx=0.5), 1.0)
    estimate = accepted(monitor.handle_attitude(_attitude(attitude), 1.02, 1.03, True))
    assert estimate.source == "LOCAL_POSITION_NED"
    assert estimate.position_world == pytest.approx([2.0, 1.01, 3.0])
    assert quaternion.angle_between(estimate.attitude, frames.attitude_enu_flu(attitude)) < 1e-9
    assert estimate.rate_body == pytest.approx([0.1, -0.2, -0.3])


def test_they_do_not_while_odometry_comes_or_when_the_position_is_old(monitor: EstimateMonitor) -> None:
    attitude = np.array([1.0, 0.0, 0.0, 0.0])
    monitor.handle_local_position(_local_position(), 1.0)
    feed(monitor, 1.0)
    assert monitor.handle_attitude(_attitude(attitude), 1.01, 1.01, True) is None
    assert monitor.handle_attitude(_attitude(attitude), 3.0, 3.0, True) is None
