"""A link in simulated time carries the same messages as one over a wire, and waits only for the simulation."""

from __future__ import annotations

import numpy as np
import pytest

from runtime.link.commands import request_rates
from runtime.link.dialect import mavlink
from runtime.link.link import LinkCallbacks
from runtime.link.parameters import read_parameter
from simulation.daemon_flight import EPOCH
from simulation.lockstep_link import LockstepLink
from sitl_mock.mock import MockOptions, build_autopilot
from vehicles import FOLDER


def open_link(frames: list[bytes] | None = None) -> LockstepLink:
    callbacks = LinkCallbacks(frame=None if frames is None else lambda direction, now, data: frames.append(data))
    link = LockstepLink(build_autopilot(MockOptions(FOLDER / "arpl_250g.toml", seed=3, epoch=EPOCH)), callbacks)
    link.wait_for_vehicle(5.0)
    return link


@pytest.fixture(scope="module")
def link() -> LockstepLink:
    return open_link()


def test_the_vehicle_is_heard_and_its_clock_and_estimates_settle(link: LockstepLink) -> None:
    assert link.status.autopilot == "px4"
    link.advance(2.0)
    assert link.peer.clock.is_valid(link.now)
    assert link.estimate is not None
    assert link.now - link.estimate.received < 0.05
    assert link.is_connected(link.now)


def test_commands_and_parameters_are_answered_as_over_a_wire(link: LockstepLink) -> None:
    assert request_rates(link, {"ODOMETRY": 100.0}) == {"ODOMETRY": "accepted"}
    assert read_parameter(link, "MAV_SYS_ID").value == 1
    link.advance(1.0)
    end, estimates = link.now + 1.0, 0
    while link.wait_for_estimate(link.estimate, end) is not None:
        estimates += 1
    assert estimates == pytest.approx(100, abs=4)


def test_an_answer_that_does_not_come_costs_simulated_time_alone(link: LockstepLink) -> None:
    before = link.now
    request = mavlink.MAVLink_param_request_read_message(9, 1, b"MAV_SYS_ID", -1)  # to nobody
    assert link.exchange(lambda _: request, lambda message: None, timeout=0.5, attempts=4) is None
    assert link.now - before == pytest.approx(2.0, abs=0.01)


def test_a_setpoint_that_is_not_finite_does_not_leave(link: LockstepLink) -> None:
    assert not link.send_rate_setpoint((float("nan"), 0.0, 0.0), 0.5)
    assert link.send_rate_setpoint((0.1, 0.2, 0.3), 0.5)


def test_the_same_seed_has_the_same_bytes() -> None:
    first: list[bytes] = []
    again: list[bytes] = []
    for frames in (first, again):
        open_link(frames).advance(1.5)
    assert len(first) > 500
    assert first == again


def test_frames_of_the_vehicle_arrive_with_the_jitter_of_its_streams() -> None:
    link = open_link()
    request_rates(link, {"ODOMETRY": 100.0})
    arrivals = []
    for _ in range(200):
        estimate = link.wait_for_estimate(link.estimate, link.now + 1.0)
        assert estimate is not None
        arrivals.append(estimate.received)
    intervals = np.diff(arrivals[20:])
    assert np.mean(intervals) == pytest.approx(0.01, rel=0.05)
    assert 0.003 < intervals.min() < 0.0085 < 0.0115 < intervals.max() < 0.02
