"""When a tick is due, whether its setpoint was late, and the cause of lateness. Pure: times are arguments, s."""

from __future__ import annotations

from enum import Enum

import msgspec
import numpy as np

from dynamics.arrays import Floats

FOLLOWING = 0.1  # share of an estimate's distance from the beat by which it moves it
CAPACITY = 400_000  # ticks whose times count for the percentiles: more than half an hour at 200 Hz


class Cause(Enum):
    """The cause of a late setpoint."""

    NONE = ""
    LINK = "link"  # no estimate came in time: the tick ran on the clock, in time, with an aged one
    SCHEDULER = "scheduler"  # this thread was ready but did not get the processor
    OURS = "ours"  # this thread was still busy, or busy for too long


class TickTimes(msgspec.Struct, frozen=True):
    """The instants of one tick, s.

    due: its trigger, an estimate's arrival or the clock.
    woken: when the thread ran.
    departed: when the setpoint was sent.
    free: when the previous tick's work was done.
    busy: processor time from `woken` to `departed`.
    busy_before: processor time of the previous tick after its departure.
    by_clock: whether the clock triggered it, because no estimate came in time.
    """

    due: float
    woken: float
    departed: float
    free: float
    busy: float
    busy_before: float
    by_clock: bool


class TimingReport(msgspec.Struct, frozen=True):
    """A flight's latencies and late setpoints; times in s.

    ticks: that sent a setpoint.
    ticks_by_clock: of those, without a fresh estimate.
    missed: late setpoints by cause.
    worst_late: the greatest lateness.
    worst_cause: its cause.
    latency: from an estimate's arrival to the setpoint's departure; median, p99, max.
    busy: processor time of the control thread therein; median, p99, max.
    interval: between departures; median, p99, max.
    """

    ticks: int
    ticks_by_clock: int
    missed: dict[str, int]
    worst_late: float
    worst_cause: str
    latency: dict[str, float]
    busy: dict[str, float]
    interval: dict[str, float]


class Schedule:
    """The trigger of a tick: the first estimate after half a period, at the latest the clock after one and a half.

    While estimates come less often than ticks are due, the clock does not wait beyond the period. An estimate moves the
    beat of the ticks by a part of its distance from it only: so they keep step with estimates of about their rate, and
    estimates of another rate do not make more of them.
    """

    def __init__(self, period: float, *, start: float) -> None:
        """period: s."""
        self.period = period
        self.estimates_keep_up = True
        self._last = start

    @property
    def latest(self) -> float:
        """When the clock triggers the next tick."""
        return self._last + (1.5 if self.estimates_keep_up else 1.0) * self.period

    @property
    def earliest(self) -> float:
        """Arrival of the first estimate that triggers the next tick."""
        return self._last + 0.5 * self.period

    def is_due(self, arrival: float) -> bool:
        """Whether an estimate that arrived at this time triggers a tick."""
        return arrival >= self.earliest

    def ticked(self, due: float, now: float, *, by_clock: bool) -> None:
        """A tick that was due then, by the clock or an estimate, runs now; missed ones are left out."""
        beat = self._last + self.period
        if now - due >= self.period:
            self._last = now
        elif by_clock or due - beat > 0.5 * self.period:
            self._last = due
        else:
            self._last = beat + FOLLOWING * (due - beat)


class Deadlines:
    """Latencies and late setpoints. A setpoint is late when it departs more than half a period after it was due."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._latency, self._busy = np.zeros(CAPACITY), np.zeros(CAPACITY)
        self._interval = np.zeros(CAPACITY)
        self._answered = self._count = 0
        self._last_departure = 0.0
        self._recent = 0.0
        self.ticks = 0
        self.missed: dict[Cause, int] = {Cause.SCHEDULER: 0, Cause.OURS: 0}
        self.by_clock = 0
        self.worst: tuple[float, Cause] = (0.0, Cause.NONE)

    @property
    def recent_share(self) -> float:
        """Share of late ticks, averaged over about the last 100."""
        return self._recent

    def add(self, times: TickTimes) -> Cause:
        """Add a tick. Returns the cause of its lateness; LINK for a tick in time without a fresh estimate."""
        self._store(times)
        self.by_clock += times.by_clock
        late = times.departed - times.due
        missed = late > 0.5 * self._period
        self._recent += 0.01 * (missed - self._recent)
        if not missed:
            return Cause.LINK if times.by_clock else Cause.NONE
        ours = times.busy + min(times.busy_before, max(times.free - times.due, 0.0))
        cause = Cause.OURS if ours >= 0.5 * late else Cause.SCHEDULER
        self.missed[cause] += 1
        if late > self.worst[0]:
            self.worst = (late, cause)
        return cause

    def _store(self, times: TickTimes) -> None:
        if not times.by_clock and self._answered < CAPACITY:
            self._latency[self._answered] = times.departed - times.due
            self._busy[self._answered] = times.busy
            self._answered += 1
        if self.ticks and self._count < CAPACITY:
            self._interval[self._count] = times.departed - self._last_departure
            self._count += 1
        self._last_departure = times.departed
        self.ticks += 1

    def report(self) -> TimingReport:
        """The figures of a flight."""
        return TimingReport(
            ticks=self.ticks,
            ticks_by_clock=self.by_clock,
            missed={cause.value: count for cause, count in self.missed.items()},
            worst_late=self.worst[0],
            worst_cause=self.worst[1].value,
            latency=percentiles(self._latency[: self._answered]),
            busy=percentiles(self._busy[: self._answered]),
            interval=percentiles(self._interval[: self._count]),
        )


def percentiles(values: Floats) -> dict[str, float]:
    """Median, 99th percentile and maximum of values (n,); NaN when there are none."""
    if not values.size:
        return dict.fromkeys(("median", "p99", "max"), float("nan"))
    median, p99, maximum = (float(value) for value in np.percentile(values, [50, 99, 100]))
    return {"median": median, "p99": p99, "max": maximum}
