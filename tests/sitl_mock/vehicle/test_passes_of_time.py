"""How simulated time passes: in full steps, without loss, and never beyond what has arrived."""

from __future__ import annotations

import pytest

from sitl_mock.autopilot.offboard import OffboardStream
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
from tests.support.bench import Bench


def test_parts_of_a_step_are_not_lost() -> None:
    bench = Bench()
    for _ in range(1000):
        bench.mock.advance(0.010)
    assert bench.mock.time == pytest.approx(10.0, abs=1e-6)


def test_time_never_passes_the_requested_duration() -> None:
    bench = Bench()
    for number in range(1, 100):
        bench.mock.advance(0.003)
        assert number * 0.003 - 0.004 < bench.mock.time <= number * 0.003 + 1e-9


def test_a_setpoint_acts_from_the_step_after_it_arrived() -> None:
    stream = OffboardStream("measured")
    first, second = ControlSetpoint("rates", thrust=0.1), ControlSetpoint("rates", thrust=0.2)
    stream.feed(1.001, first)
    stream.feed(1.005, second)
    assert stream.setpoint(1.000) is None
    assert stream.setpoint(1.004) is first
    assert stream.setpoint(1.008) is second
    assert stream.setpoint(1.012) is second
