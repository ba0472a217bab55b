"""The cause of what a flight shows: this computer, the link, another controller; what remains is the vehicle. Pure.

A check that compares what was sent with what happened takes for granted that both are known. Where ticks were missed,
estimates came irregularly or somebody else's setpoints acted, they are not: the check waits, and the cause is named.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Mapping

from runtime.flight.events import Event
from runtime.link.estimate import StateEstimate

STALL = 0.05  # s between two ticks; the clock triggers one after one and a half periods, without estimates as well
STALL_PERIODS = 4.0  # periods between them, where that is more
STARVED_SHARE, STARVED_WINDOW = 0.35, 2.0  # of the last so many s in stalls, beyond which nothing is under control
WINDOW = 1.0  # s of estimates whose arrival is judged
SPREAD = 0.06  # s of the estimates' ages at arrival, or between two of them; PX4's own stream varies by 16 ms
MIN_LATE = 3  # estimates that came so late within the window
MIN_SAMPLES = 10
DIRTY = 0.5  # s after a disturbance of the data until the checks' windows hold none of it
# checks of what was sent against what happened, all of which a disturbance of the data can feign
FEIGNED = (Event.IMPACT, Event.GROUND_CONTACT, Event.HELD)


class Attribution:
    """Finds disturbances of the data, and names them in place of what they feign."""

    def __init__(self, period: float) -> None:
        """period: of the control thread, s."""
        self._stall = max(STALL, STALL_PERIODS * period)
        self._ticked: float | None = None
        self._stalls: deque[tuple[float, float]] = deque()
        self._arrivals: deque[tuple[float, float]] = deque()
        self._jittery = -float("inf")
        self._jitter = ""
        self._time = 0.0

    def observe(self, time: float, estimate: StateEstimate | None, *, fresh: bool) -> None:
        """Take one tick. time: s. fresh: whether the estimate is newer than at the last tick."""
        before, self._ticked, self._time = self._ticked, time, time
        if before is not None and time - before > self._stall:
            self._stalls.append((time, time - before))
            self._arrivals.clear()  # what came meanwhile waited for this computer
        while self._stalls and self._stalls[0][0] < time - STARVED_WINDOW:
            self._stalls.popleft()
        if fresh and estimate is not None:
            self._arrivals.append((estimate.received, estimate.received - estimate.time))
        while self._arrivals and self._arrivals[0][0] < time - WINDOW:
            self._arrivals.popleft()
        self._jitter = self._judge_arrivals()
        if self._jitter:
            self._jittery = time

    @property
    def standstill(self) -> float:
        """The longest time without a tick within the last seconds, s; 0 without any."""
        return max((gap for _, gap in self._stalls), default=0.0)

    def attribute(self, present: Mapping[Event, str]) -> dict[Event, str]:
        """Events with their true names, from those present by the checks."""
        named = dict(present)
        host, jitter = self._host(), self._time - self._jittery < DIRTY
        if self._stalls and self._stalls[-1][0] == self._time:
            named[Event.HOST_STALLED] = (
                f"for {1e3 * self._stalls[-1][1]:.0f} ms; close other programs or give it priority"
            )
        if self._jitter:
            named[Event.LINK_JITTER] = self._jitter
        stalled = sum(gap for _, gap in self._stalls)
        if stalled > STARVED_SHARE * STARVED_WINDOW:
            named[Event.HOST_STARVED] = f"{host}; close other programs or give it priority"
        dirty = jitter or Event.OTHER_CONTROLLER in present or self._is_after_stall
        if dirty:
            for event in FEIGNED:
                named.pop(event, None)
        if Event.SETPOINT_REFUSED in named and (cause := self._cause(named, host)):
            named[cause[0]] = cause[1]
            del named[Event.SETPOINT_REFUSED]
        return self._explain_stale(named, host)

    @property
    def _is_after_stall(self) -> bool:
        return bool(self._stalls) and self._time - self._stalls[-1][0] < DIRTY

    def _cause(self, named: Mapping[Event, str], host: str) -> tuple[Event, str] | None:
        if Event.OTHER_CONTROLLER in named:
            return Event.OTHER_CONTROLLER, named[Event.OTHER_CONTROLLER]
        if host or Event.DEADLINES_MISSED in named:
            late = named.get(Event.DEADLINES_MISSED, "")
            return Event.HOST_STARVED, f"{host or f'ticks are late, {late}'}; close other programs or give it priority"
        if self._time - self._jittery < WINDOW + DIRTY:
            return Event.LINK_UNSTEADY, self._jitter or "until a moment ago"
        return None

    def _host(self) -> str:
        """Stalls of this computer lately, empty for none."""
        if not self._stalls:
            return ""
        stalled = sum(gap for _, gap in self._stalls)
        return f"no tick for {1e3 * stalled:.0f} ms of the last {STARVED_WINDOW:g} s"

    def _explain_stale(self, named: dict[Event, str], host: str) -> dict[Event, str]:
        if Event.ESTIMATE_STALE in named:
            if self._is_after_stall:
                named[Event.ESTIMATE_STALE] += f"; this computer had {host}"
            elif self._jitter:
                named[Event.ESTIMATE_STALE] += f"; on the link, {self._jitter}"
        return named

    def _judge_arrivals(self) -> str:
        if len(self._arrivals) < MIN_SAMPLES:
            return ""
        times, ages = zip(*self._arrivals, strict=True)
        gaps = [after - before for before, after in itertools.pairwise(times)]
        youngest = min(ages)
        late = sum(age > youngest + SPREAD for age in ages)
        apart = sum(gap > SPREAD for gap in gaps)
        if max(late, apart) < MIN_LATE:
            return ""
        return (
            f"estimates come {1e3 * min(gaps):.0f} to {1e3 * max(gaps):.0f} ms apart and are "
            f"{1e3 * youngest:.0f} to {1e3 * max(ages):.0f} ms old when they do; look at radio, cable and router"
        )
