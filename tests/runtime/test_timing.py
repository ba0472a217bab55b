"""Ticks are triggered by estimates or the clock, and the cause of a late one is named."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.arrays import Floats
from runtime.timing import Cause, Deadlines, Schedule, TickTimes, percentiles

PERIOD = 0.01


def test_the_first_estimate_after_half_a_period_triggers_the_tick() -> None:
    schedule = Schedule(PERIOD, start=1.0)
    assert not schedule.is_due(1.004)
    assert schedule.is_due(1.006)
    assert schedule.latest == pytest.approx(1.015)


def test_slow_estimates_do_not_slow_the_ticks() -> None:
    schedule = Schedule(PERIOD, start=1.0)
    schedule.estimates_keep_up = False
    assert schedule.latest == pytest.approx(1.01)
    ticks = 0
    now = 1.0
    while now < 2.0:
        now = schedule.latest
        schedule.ticked(now, now, by_clock=True)
        ticks += 1
    assert ticks == pytest.approx(100, abs=1)


def test_after_a_long_pause_what_was_missed_is_not_made_up_for() -> None:
    schedule = Schedule(PERIOD, start=1.0)
    schedule.ticked(1.015, 1.5, by_clock=True)
    assert schedule.latest == pytest.approx(1.515)


def ticks_of(rate: float, arrivals: Floats, *, keep_up: bool) -> tuple[float, float]:
    """Ticks per second, and the share of them that an estimate triggered."""
    schedule, at, ticks, by_clock = Schedule(1.0 / rate, start=0.0), 0, 0, 0
    schedule.estimates_keep_up = keep_up
    while at < len(arrivals):
        if arrivals[at] <= schedule.latest and not schedule.is_due(arrivals[at]):
            at += 1
            continue
        clock = arrivals[at] > schedule.latest
        due = schedule.latest if clock else float(arrivals[at])
        schedule.ticked(due, due + 2e-4, by_clock=clock)
        ticks, by_clock, at = ticks + 1, by_clock + clock, at + (not clock)
    return ticks / float(arrivals[-1]), 1.0 - by_clock / ticks


@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0])
@pytest.mark.parametrize("estimates", [62.5, 124.0, 250.0])
def test_ticks_come_at_their_rate_whatever_the_rate_of_the_estimates(rate: float, estimates: float) -> None:
    random = np.random.default_rng(0)
    arrivals = np.sort(np.arange(4000) / estimates + random.normal(0.0, 3e-4, 4000))
    achieved, _ = ticks_of(rate, arrivals, keep_up=estimates >= 0.9 * rate)
    assert achieved == pytest.approx(rate, rel=0.045)


def test_ticks_keep_step_with_estimates_of_px4_s_jitter() -> None:
    """PX4 in simulation sends 100 Hz in intervals of 8, 12 and 16 ms."""
    arrivals = np.ceil(np.arange(4000) * 0.0101 / 0.004) * 0.004
    achieved, triggered = ticks_of(100.0, arrivals, keep_up=True)
    assert achieved == pytest.approx(1 / 0.0101, rel=0.01)
    assert triggered > 0.99


def times(due: float, *, wait: float, work: float, free: float = 0.0, by_clock: bool = False) -> TickTimes:
    return TickTimes(due, due + wait, due + wait + work, free, work, max(free - due, 0.0), by_clock)


def test_a_tick_in_time_is_not_counted_as_missed() -> None:
    deadlines = Deadlines(PERIOD)
    assert deadlines.add(times(1.0, wait=0.0001, work=0.0004)) is Cause.NONE
    assert deadlines.add(times(1.015, wait=0.0001, work=0.0004, by_clock=True)) is Cause.LINK
    assert deadlines.report().missed == {"scheduler": 0, "ours": 0}
    assert deadlines.by_clock == 1


def test_a_late_tick_is_attributed_to_what_took_the_time() -> None:
    deadlines = Deadlines(PERIOD)
    assert deadlines.add(times(1.0, wait=0.008, work=0.0005)) is Cause.SCHEDULER
    assert deadlines.add(times(2.0, wait=0.0001, work=0.009)) is Cause.OURS
    # woken late because the previous tick's preparation was still running
    assert deadlines.add(times(3.0, wait=0.008, work=0.0005, free=3.0079)) is Cause.OURS
    # at work for long by the wall clock, but the processor was elsewhere
    assert deadlines.add(TickTimes(4.0, 4.0001, 4.012, 0.0, 0.0005, 0.0, False)) is Cause.SCHEDULER
    # the previous tick took long because the processor was elsewhere
    assert deadlines.add(TickTimes(5.0, 5.008, 5.0085, 5.0079, 0.0005, 0.0004, False)) is Cause.SCHEDULER
    report = deadlines.report()
    assert report.missed == {"scheduler": 3, "ours": 2}
    assert report.worst_cause == "scheduler"


def test_latencies_count_from_the_estimate_s_arrival_only() -> None:
    deadlines = Deadlines(PERIOD)
    for tick in range(100):
        deadlines.add(times(tick * PERIOD, wait=0.0002, work=0.0003))
        deadlines.add(times(tick * PERIOD + 0.015, wait=0.004, work=0.0003, by_clock=True))
    assert deadlines.report().latency["max"] == pytest.approx(0.0005)


def test_percentiles_of_nothing_are_not_a_number() -> None:
    assert np.isnan(percentiles(np.zeros(0))["median"])
