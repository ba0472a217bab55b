"""The streams that PX4 sends by default and on request, their regularity and their content, measured from outside."""

from __future__ import annotations

import itertools
import statistics
import time

import pytest

from tests.conformance.raw_link import SET_INTERVAL, RawLink, mavlink

pytestmark = pytest.mark.realtime

DEFAULT_RATES = {
    "ATTITUDE": 100.0,
    "ATTITUDE_QUATERNION": 50.0,
    "HIGHRES_IMU": 50.0,
    "ODOMETRY": 30.0,
    "LOCAL_POSITION_NED": 30.0,
    "SERVO_OUTPUT_RAW": 10.0,
    "ATTITUDE_TARGET": 10.0,
    "TIMESYNC": 10.0,
    "SYS_STATUS": 5.0,
    "EXTENDED_SYS_STATE": 5.0,
    "HEARTBEAT": 1.0,
    "SYSTEM_TIME": 1.0,
    "ESTIMATOR_STATUS": 1.0,
}
# on the recorded link to PX4 besides those, from the start of the flight on
ALSO_RECORDED = {
    "ALTITUDE": 10.0,
    "DISTANCE_SENSOR": 10.0,
    "GLOBAL_POSITION_INT": 50.0,
    "GPS_RAW_INT": 8.0,
    "MISSION_CURRENT": 1.0,
    "PING": 1.0,
    "SCALED_PRESSURE": 1.0,
    "VFR_HUD": 10.0,
}
WINDOW = 3.0  # s
ODOMETRY, ATTITUDE_QUATERNION = 331, 31


@pytest.fixture(scope="module")
def rates(link: RawLink) -> dict[str, float]:
    """Messages per second of the vehicle's time, by kind."""
    start = time.monotonic()
    time.sleep(WINDOW + 0.5)
    stamps = [message.time_boot_ms for _, message in link.since(start, "ATTITUDE")]
    span = (stamps[-1] - stamps[0]) * 1e-3
    kinds = {message.get_type() for _, message in link.heard}
    return {kind: len(link.since(start, kind)) / span for kind in kinds}


@pytest.mark.parametrize(("kind", "rate"), [*DEFAULT_RATES.items(), *ALSO_RECORDED.items()])
def test_the_default_rates_are_px4s(rates: dict[str, float], kind: str, rate: float) -> None:
    assert rates[kind] == pytest.approx(rate, rel=0.05, abs=2.0 / WINDOW)


def test_the_battery_is_reported_every_two_seconds(link: RawLink, rates: dict[str, float]) -> None:
    assert rates["BATTERY_STATUS"] == pytest.approx(0.5, abs=0.26)


def spacing(link: RawLink, kind: str, seconds: float) -> list[float]:
    """Seconds of the vehicle's time between messages of a kind."""
    field = "time_usec" if kind == "ODOMETRY" else "time_boot_ms"
    stamps = [getattr(message, field) for _, message in link.messages(kind, seconds)]
    scale = 1e-6 if kind == "ODOMETRY" else 1e-3
    return [(after - before) * scale for before, after in itertools.pairwise(stamps)]


@pytest.mark.slow
@pytest.mark.parametrize(("requested", "achieved"), [(100.0, 100.0), (200.0, 124.0), (125.0, 124.0), (20.0, 20.0)])
def test_rates_are_quantised_to_steps_of_4_ms(link: RawLink, requested: float, achieved: float) -> None:
    link.set_rate(ATTITUDE_QUATERNION, requested)
    gaps = spacing(link, "ATTITUDE_QUATERNION", 1.0)
    assert 1.0 / statistics.mean(gaps) == pytest.approx(achieved, rel=0.04)
    assert all(gap * 1e3 / 4 == pytest.approx(round(gap * 1e3 / 4), abs=0.3) for gap in gaps)


def test_a_stream_of_10_ms_has_px4s_jitter(link: RawLink) -> None:
    link.set_rate(ODOMETRY, 100.0)
    times = [at for at, _ in link.messages("ODOMETRY", 2.0)]
    gaps = sorted((after - before) * 1e3 for before, after in itertools.pairwise(times))
    # 8 and 12 ms take turns, and little lies between them: the median may fall on either side, the mean may not
    assert statistics.mean(gaps) == pytest.approx(10.0, abs=0.3)
    assert gaps[len(gaps) // 10] < 9.0
    assert 11.0 < gaps[len(gaps) * 9 // 10] < 20.0


def test_message_interval_reports_the_request_not_what_is_achieved(link: RawLink) -> None:
    link.set_rate(ATTITUDE_QUATERNION, 200.0)
    start = time.monotonic()
    assert link.result(510, ATTITUDE_QUATERNION) == 0
    _, answer = link.wait_for("MESSAGE_INTERVAL", since=start)
    assert (answer.message_id, answer.interval_us) == (ATTITUDE_QUATERNION, 5000)


def test_an_interval_of_minus_one_stops_and_zero_restores(link: RawLink) -> None:
    altitude = 141
    assert link.result(SET_INTERVAL, altitude, -1) == 0
    time.sleep(0.05)
    assert link.messages("ALTITUDE", 0.5) == []
    assert link.result(SET_INTERVAL, altitude, 0) == 0
    assert len(link.messages("ALTITUDE", 1.0)) in range(7, 13)


@pytest.mark.parametrize("identifier", [0, 9999])
def test_the_interval_of_a_heartbeat_or_of_an_unknown_message_cannot_be_set(link: RawLink, identifier: int) -> None:
    assert link.result(SET_INTERVAL, identifier, 10_000) == mavlink.MAV_RESULT_FAILED


def test_acks_come_within_16_ms_to_their_requester(link: RawLink) -> None:
    delays = []
    for _ in range(30):
        delay, ack = link.command(510, ODOMETRY)
        assert (ack.target_system, ack.target_component) == (1, 191)
        delays.append(delay)
    assert 0.0005 < statistics.median(delays) < 0.020
    assert max(delays) - min(delays) > 0.004


def test_odometry_is_in_local_ned_velocity_too_and_its_counter_does_not_begin_at_zero(link: RawLink) -> None:
    newest = link.newest("ODOMETRY")
    assert (newest.frame_id, newest.child_frame_id, newest.estimator_type) == (1, 1, 8)
    assert newest.reset_counter in (9, 10, 11)
    assert len({message.reset_counter for _, message in link.since(0.0, "ODOMETRY")}) == 1


def test_the_messages_constants_are_those_of_the_recording(link: RawLink) -> None:
    beat, status = link.newest("HEARTBEAT"), link.newest("SYS_STATUS")
    assert (beat.type, beat.autopilot, beat.mavlink_version) == (2, 12, 3)
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 1)
    assert (beat.base_mode, beat.custom_mode, beat.system_status) == (29, 4 << 16 | 3 << 24, 3)
    assert status.onboard_control_sensors_present == 50348079
    assert status.onboard_control_sensors_enabled == 50413615
    assert status.onboard_control_sensors_health == 320915519
    assert link.newest("SERVO_OUTPUT_RAW").servo1_raw == 900
    assert link.newest("ATTITUDE_TARGET").type_mask == 0
    assert (link.newest("EXTENDED_SYS_STATE").landed_state, link.newest("GPS_RAW_INT").fix_type) == (1, 3)
    assert link.newest("ESTIMATOR_STATUS").flags in (895, 1023)  # 1023 in the first seconds after its start
    assert link.newest("ATTITUDE").yaw == pytest.approx(0.0, abs=0.1)  # it stands facing north


def test_the_sequence_number_counts_every_frame(link: RawLink) -> None:
    start = time.monotonic()
    time.sleep(0.5)
    numbers = [message.get_msgbuf()[4] for at, message in link.heard if at >= start]
    steps = [(after - before) % 256 for before, after in itertools.pairwise(numbers)]
    assert steps.count(1) >= 0.99 * len(steps)


def test_timesync_is_answered_with_the_vehicles_nanoseconds(link: RawLink) -> None:
    ours = 123_456_789_012_345
    sent = link.send(mavlink.MAVLink_timesync_message(0, ours))
    at, reply = link.wait_for("TIMESYNC", lambda message: message.tc1 != 0, since=sent)
    assert reply.ts1 == ours
    assert at - sent < 0.1
    boot = link.newest("ATTITUDE").time_boot_ms * 1e-3
    assert reply.tc1 * 1e-9 == pytest.approx(boot, abs=0.1)


def test_the_vehicle_requests_the_time_itself(link: RawLink) -> None:
    requests = [message for _, message in link.messages("TIMESYNC", 0.5) if message.tc1 == 0]
    assert 3 <= len(requests) <= 7
    assert requests[-1].ts1 * 1e-9 == pytest.approx(link.newest("ATTITUDE").time_boot_ms * 1e-3, abs=0.3)


@pytest.mark.parametrize("identifier", [148, 242, 245, 264, 300, 331])
def test_a_message_can_be_requested_once(link: RawLink, identifier: int) -> None:
    start = time.monotonic()
    assert link.result(512, identifier) == 0
    deadline = start + 2.0
    while time.monotonic() < deadline:
        if any(at >= start and message.get_msgId() in (identifier, -2) for at, message in list(link.heard)):
            return
        time.sleep(0.01)
    raise AssertionError(f"message {identifier} did not come")
