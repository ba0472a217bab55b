"""Topics that another clock stamped, and stamps of a clock that was set, are told by the time of recording."""

from __future__ import annotations

import numpy as np
import pytest

from flights.assembly import Assembly
from flights.readers.bag_clocks import CLOCK_STEP, OTHER_CLOCK, clocks_of

SECOND = 1_000_000_000
RECORDED = 1_760_000_000 * SECOND + np.arange(0, 20 * SECOND, SECOND // 100)


def delayed(seconds: float) -> np.ndarray:
    """Recorded after a transport of some milliseconds."""
    noise = np.random.default_rng(1).uniform(0.0, 0.004, len(RECORDED))
    return RECORDED - ((seconds + noise) * SECOND).astype(np.int64)


@pytest.mark.parametrize("seconds", [37.5, -4.0, 1_759_999_910.0])
def test_a_topic_of_another_clock_is_aligned_by_the_recording(seconds: float) -> None:
    assembly = Assembly()
    stamps = {"/pose": delayed(0.0), "/imu": delayed(seconds)}
    clocks = clocks_of(stamps, dict.fromkeys(stamps, RECORDED), assembly)
    assert clocks["/pose"].shift == 0
    aligned = stamps["/imu"] + clocks["/imu"].shift
    assert np.abs(aligned - stamps["/pose"]).max() < 0.005 * SECOND
    (repair,) = assembly.finish().repairs
    assert repair.name == OTHER_CLOCK
    assert f"{seconds:.3f} s later than its stamps" in repair.detail


def test_a_slow_transport_is_no_other_clock() -> None:
    assembly = Assembly()
    clocks = clocks_of(
        {"/pose": delayed(0.0), "/imu": delayed(0.3)}, dict.fromkeys(["/pose", "/imu"], RECORDED), assembly
    )
    assert clocks["/imu"].shift == 0
    assert assembly.finish().repairs == ()


def test_messages_whose_clock_was_set_are_left_out() -> None:
    assembly = Assembly()
    stamps = delayed(0.0)
    stamps[800:1100] -= int(1.2 * SECOND)
    clock = clocks_of({"/imu": stamps}, {"/imu": RECORDED}, assembly)["/imu"]
    assert not clock.rows[800:1100].any()
    assert clock.rows[:800].all()
    assert clock.rows[1100:].all()
    (repair,) = assembly.finish().repairs
    assert repair.name == CLOCK_STEP
    assert "1.2" in repair.detail


def test_a_stalled_recorder_loses_nothing() -> None:
    stamps, recorded = delayed(0.0), RECORDED.copy()
    recorded[500:600] = recorded[600]  # written together when the disk answered again
    assembly = Assembly()
    clock = clocks_of({"/imu": stamps}, {"/imu": recorded}, assembly)["/imu"]
    assert clock.rows.all()
    assert assembly.finish().repairs == ()
