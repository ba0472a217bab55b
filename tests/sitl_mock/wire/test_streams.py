"""What the mock sends, how often, and what SET_MESSAGE_INTERVAL changes."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from sitl_mock.wire.link import Link
from sitl_mock.wire.streams import STEP, Streams
from sitl_mock.wire.telemetry import BUILDERS
from tests.support.bench import GET_INTERVAL, REQUEST, SET_INTERVAL, Bench, finite

# rates measured on PX4's offboard link, Hz (docs/px4.md)
MEASURED = {
    "ATTITUDE": 100,
    "ATTITUDE_QUATERNION": 50,
    "HIGHRES_IMU": 50,
    "ODOMETRY": 30,
    "LOCAL_POSITION_NED": 30,
    "SERVO_OUTPUT_RAW": 10,
    "TIMESYNC": 10,
    "SYS_STATUS": 5,
    "EXTENDED_SYS_STATE": 5,
    "HEARTBEAT": 1,
    "SYSTEM_TIME": 1,
    "ATTITUDE_TARGET": 10,
    "ESTIMATOR_STATUS": 1,
    "BATTERY_STATUS": 0.5,
}
ODOMETRY = 331


def test_onboard_link_streams_at_the_measured_default_rates_before_anyone_spoke() -> None:
    bench = Bench()
    bench.run(20.0)
    counts = {kind: len(bench.of(kind)) / 20.0 for kind in MEASURED}
    assert counts == pytest.approx(MEASURED, rel=0.03)


def test_frames_are_numbered_without_gaps() -> None:
    bench = Bench()
    messages = bench.run(2.0)
    numbers = np.array([int(message.get_msgbuf()[4]) for message in messages])
    assert set(np.diff(numbers) % 256) == {1}


def test_attitude_target_is_the_active_setpoint() -> None:
    bench = Bench()
    bench.fly()
    before = len(bench.of("ATTITUDE_TARGET"))
    bench.stream(2.0, thrust=0.5)
    assert len(bench.of("ATTITUDE_TARGET")) - before == pytest.approx(20, abs=1)
    assert bench.of("ATTITUDE_TARGET")[-1].thrust == pytest.approx(0.5)


def test_ground_station_link_is_slower() -> None:
    bench = Bench(role="gcs")
    bench.run(10.0)
    assert len(bench.of("ATTITUDE")) == pytest.approx(150, abs=2)
    assert not bench.of("ODOMETRY")


@pytest.mark.parametrize(("requested", "achieved"), [(250, 250), (200, 124), (100, 100), (50, 50), (10, 10)])
def test_rates_are_quantised_to_the_four_millisecond_step(requested: float, achieved: float) -> None:
    bench = Bench()
    assert bench.request(SET_INTERVAL, ODOMETRY, 1e6 / requested) == 0
    before = len(bench.of("ODOMETRY"))
    bench.run(5.0)
    assert (len(bench.of("ODOMETRY")) - before) / 5.0 == pytest.approx(achieved, rel=0.015)


def test_message_interval_reports_the_request_and_not_what_is_achieved() -> None:
    bench = Bench()
    bench.request(SET_INTERVAL, ODOMETRY, 5000)
    assert bench.request(GET_INTERVAL, ODOMETRY) == 0
    reported = bench.of("MESSAGE_INTERVAL")[-1]
    assert (reported.message_id, reported.interval_us) == (ODOMETRY, 5000)


@pytest.mark.parametrize("identifier", [0, 9999, 253])
def test_interval_of_the_heartbeat_or_an_unknown_message_fails(identifier: int) -> None:
    bench = Bench()
    assert bench.request(SET_INTERVAL, identifier, 100_000) == 4
    bench.run(3.0)
    assert len(bench.of("HEARTBEAT")) == 4


def test_minus_one_stops_a_stream_and_zero_brings_its_default_back() -> None:
    bench = Bench()
    bench.request(SET_INTERVAL, ODOMETRY, -1)
    before = len(bench.of("ODOMETRY"))
    bench.run(1.0)
    assert len(bench.of("ODOMETRY")) == before
    bench.request(SET_INTERVAL, ODOMETRY, 0)
    bench.run(2.0)
    assert len(bench.of("ODOMETRY")) - before == pytest.approx(60, abs=3)


def test_jitter_of_a_hundred_hertz_stream_is_px4s() -> None:
    link = Link("test", "onboard", 1, frozenset(BUILDERS))
    link.streams.set_interval(0.0, ODOMETRY, 10_000)
    sent = []
    for number in range(15_000):
        departure = link.loop_time(number * STEP)
        if ODOMETRY in link.streams.due(number * STEP):
            sent.append(departure)
    intervals = np.diff(sent) * 1e3
    low, middle, high = np.percentile(intervals, [1, 50, 99])
    assert low == pytest.approx(5.9, abs=0.5)
    assert middle == pytest.approx(10.1, abs=1.0)  # between the 8 and 12 ms that PX4 alternates between
    assert intervals.mean() == pytest.approx(10.0, abs=0.02)
    assert high == pytest.approx(14.3, abs=0.5)
    assert 15.0 <= intervals.max() <= 16.5


def test_a_message_is_sent_once_on_request() -> None:
    bench = Bench()
    assert bench.request(REQUEST, 148) == 0
    (version,) = bench.of("AUTOPILOT_VERSION")
    assert version.flight_sw_version >> 24 == 1
    assert bench.request(REQUEST, 9999) == 2


def test_capabilities_home_and_origin_can_be_requested() -> None:
    bench = Bench()
    assert bench.request(520, 1) == 0
    assert bench.of("AUTOPILOT_VERSION")
    assert bench.request(410) == 0
    assert bench.of("HOME_POSITION")[-1].latitude == pytest.approx(473977428, abs=10)
    assert bench.request(REQUEST, 49) == 0
    assert bench.of("GPS_GLOBAL_ORIGIN")[-1].longitude == pytest.approx(85455967, abs=10)


def test_every_default_message_carries_finite_numbers() -> None:
    bench = Bench()
    bench.run(3.0)
    for kind in ("ODOMETRY", "LOCAL_POSITION_NED", "ATTITUDE", "HIGHRES_IMU"):
        fields = bench.of(kind)[-1].to_dict()
        assert finite(value for value in fields.values() if isinstance(value, float)), fields


def test_rotor_speeds_travel_in_px4s_motor_order_at_up_to_250_hertz() -> None:
    bench = Bench()
    bench.fly()
    assert bench.request(SET_INTERVAL, 291, 4000) == 0
    before = len(bench.heard)
    for _ in range(10):
        bench.stream(0.1, thrust=0.5)
    frames = [message for _, message in bench.heard[before:] if message.get_msgId() == -2]
    status = [bytes(frame.get_msgbuf()) for frame in frames if frame.get_msgbuf()[7] == 291 & 0xFF]
    assert len(status) == pytest.approx(250, abs=3)
    payload = status[-1][10:-2].ljust(57, b"\0")
    rpm = struct.unpack("<Q4i4f4fB", payload)[1:5]
    ours = bench.vehicle.rotor_speed * 60 / (2 * np.pi)
    # PX4: 1 front right, 2 back left, 3 front left, 4 back right; ours: front left, back left, back right, front right
    assert rpm == pytest.approx(ours[[3, 1, 0, 2]], abs=1)


def test_servo_outputs_are_900_disarmed_and_follow_the_motors_armed() -> None:
    bench = Bench()
    bench.run(0.5)
    assert bench.of("SERVO_OUTPUT_RAW")[-1].servo1_raw == 900
    bench.fly()
    last = bench.of("SERVO_OUTPUT_RAW")[-1]
    assert last.servo3_raw == pytest.approx(1500, abs=5)
    assert last.servo1_raw > last.servo4_raw > last.servo2_raw > last.servo3_raw


QUATERNION = 31


@pytest.mark.parametrize("seed", range(20))
def test_200_hz_is_quantised_at_any_time_of_the_request(seed: int) -> None:
    streams = Streams("onboard", frozenset({QUATERNION}), seed)
    start = 0.004 * 7 + 0.004 * seed / 20
    streams.set_interval(start, QUATERNION, 5000)
    sent = sum(QUATERNION in streams.due(0.004 * step) for step in range(8, 1008))
    assert sent == pytest.approx(500, abs=3)
