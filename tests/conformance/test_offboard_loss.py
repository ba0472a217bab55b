"""What happens in the air when the stream of setpoints stops, and when it comes back, observed from outside."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

import pytest

from tests.conformance.raw_link import HOLD, LAND, OFFBOARD, RTL, RawLink, Stream, hover_at
from tests.conformance.test_parameters_and_texts import write_float, write_integer

pytestmark = pytest.mark.realtime

HEIGHT = 5.0  # m
MARGIN = 0.08  # s that a busy machine may add to what PX4 takes


@pytest.fixture(scope="module")
def stream(link: RawLink) -> Iterator[Stream]:
    """The stream of setpoints of a vehicle that has taken off in OFFBOARD, its mode requested 100 times a second."""
    link.set_rate(331, 100.0)
    with link.setpoints(hover_at(HEIGHT)) as stream, link.watching_mode():
        link.set_mode(OFFBOARD)
        time.sleep(1.3)
        assert link.arm() == 0
        link.wait_for("ODOMETRY", lambda here: here.z < -3.0)
        yield stream


@pytest.fixture
def flying(link: RawLink, stream: Stream) -> Iterator[Stream]:
    """The stream of a vehicle in OFFBOARD."""
    yield stream
    stream.make = hover_at(HEIGHT)
    before, deadline = len(stream.sent), time.monotonic() + 5.0
    while len(stream.sent) < before + 5 and time.monotonic() < deadline:
        time.sleep(0.02)
    link.wait_for_mode(OFFBOARD)


def fall_silent(stream: Stream) -> float:
    """Stop the setpoints; returns when the last one left."""
    stream.make = lambda _: None
    time.sleep(0.03)
    return stream.last


def test_loss_shows_after_the_timeout_as_rtl_and_critical(link: RawLink, flying: Stream) -> None:
    lost = fall_silent(flying)
    at = link.wait_for_mode(RTL, since=lost)
    assert 1.0 < at - lost < 1.12 + MARGIN  # COM_OF_LOSS_T of 1 s and 0.02 to 0.12 s
    beat = link.newest("HEARTBEAT")
    assert (beat.system_status, beat.base_mode) == (5, 157)


def test_the_vehicle_takes_offboard_back_by_itself_when_the_stream_resumes(link: RawLink, flying: Stream) -> None:
    link.wait_for_mode(RTL, since=fall_silent(flying))
    resumed = time.monotonic()
    flying.make = hover_at(HEIGHT)
    at = link.wait_for_mode(OFFBOARD, since=resumed)
    assert 0.002 < at - resumed < 0.023 + 0.01 + MARGIN
    assert link.newest("HEARTBEAT").system_status == 4


@pytest.mark.slow
@pytest.mark.parametrize(("action", "mode"), [(0, RTL), (1, RTL), (2, RTL), (3, RTL), (4, LAND), (5, HOLD)])
def test_com_obl_rc_act_chooses_the_mode_without_a_radio(link: RawLink, flying: Stream, action: int, mode: int) -> None:
    write_float(link, "COM_OF_LOSS_T", 0.4)
    write_integer(link, "COM_OBL_RC_ACT", action)
    lost = fall_silent(flying)
    at = link.wait_for_mode(mode, since=lost)
    assert 0.4 < at - lost < 0.52 + MARGIN
    flying.make = hover_at(HEIGHT)
    link.wait_for_mode(OFFBOARD, since=time.monotonic())
    write_integer(link, "COM_OBL_RC_ACT", 0)
    write_float(link, "COM_OF_LOSS_T", 1.0)


@pytest.mark.slow
def test_a_slow_stream_flips_the_mode_every_period(link: RawLink, flying: Stream) -> None:
    start = time.monotonic()
    flying.period = 1.25
    time.sleep(5.5)
    flying.period = 0.01
    modes = [beat.custom_mode for _, beat in link.since(start, "HEARTBEAT")]
    flips = sum(before == OFFBOARD and after == RTL for before, after in itertools.pairwise(modes))
    assert flips in (3, 4, 5)
    assert set(modes) == {OFFBOARD, RTL}


@pytest.mark.slow
def test_the_companions_heartbeat_changes_nothing(link: RawLink, flying: Stream) -> None:
    start = time.monotonic()
    link.fall_silent()
    time.sleep(3.0)
    assert {beat.custom_mode for _, beat in link.since(start, "HEARTBEAT")} == {OFFBOARD}
