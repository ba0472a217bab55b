"""TIMESYNC: the vehicle answers with its own clock, sends requests at 10 Hz itself, and drifts."""

from __future__ import annotations

import pytest

from sitl_mock.vehicle.clock import VehicleClock
from sitl_mock.wire.dialect import mavlink
from tests.support.bench import Bench


def offset(bench: Bench) -> float:
    before = len(bench.of("TIMESYNC"))
    bench.send(mavlink.MAVLink_timesync_message(0, 123_456_789))
    bench.run(0.004)
    (reply,) = [message for message in bench.of("TIMESYNC")[before:] if message.tc1 != 0]
    assert reply.ts1 == 123_456_789
    return reply.tc1 * 1e-9 - bench.time


def test_a_request_is_answered_with_the_vehicles_nanoseconds() -> None:
    bench = Bench()
    bench.run(1.0)
    assert offset(bench) == pytest.approx(3.0, abs=0.005)


def test_the_vehicle_sends_requests_of_its_own_at_ten_hertz() -> None:
    bench = Bench()
    bench.run(5.0)
    requests = bench.of("TIMESYNC")
    assert len(requests) == pytest.approx(50, abs=1)
    assert all(message.tc1 == 0 and message.ts1 > 0 for message in requests)


def test_the_offset_drifts_with_the_clock() -> None:
    bench = Bench(clock_drift=0.01)
    first = offset(bench)
    bench.run(10.0)
    assert offset(bench) - first == pytest.approx(0.1, abs=0.005)


def test_the_answer_to_its_own_request_is_not_answered_again() -> None:
    bench = Bench()
    bench.send(mavlink.MAVLink_timesync_message(1_000, 2_000))
    bench.run(0.004)
    assert not [message for message in bench.of("TIMESYNC") if message.tc1 != 0]


def test_the_clock_can_be_set_back_but_never_below_zero() -> None:
    clock = VehicleClock()
    clock.jump(-10.0)
    assert clock.at(1.0) == 0.0
    assert clock.at(20.0) == pytest.approx(13.0, abs=0.01)
