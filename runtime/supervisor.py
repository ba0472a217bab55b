"""The supervisor: what may take long while the control thread flies, in the caller's thread."""

from __future__ import annotations

import time
from collections.abc import Callable

from runtime import realtime
from runtime.announcements import Announcements, NotificationFeed
from runtime.control_thread import ControlThread, Requests
from runtime.flight.engagement import Engagement, State
from runtime.flight.events import Event, Severity
from runtime.link.link import Link
from runtime.request_worker import RequestWorker
from runtime.service_manager import ServiceManager
from runtime.stream_requests import StreamRequests
from runtime.stream_watch import StreamWatch

SUPERVISION_PERIOD = 0.1  # s
READINESS_PATIENCE = 10.0  # s until no check may refuse engaging any more
PILOT_REMINDER = 10.0  # s between the lines that say that the pilot is to arm
REQUEST_PATIENCE = 2.5  # s in which the autopilot is to answer the last request, such as LAND
LANDING_PATIENCE = 60.0  # s from a request to land until streaming is stopped


class SchedulingReport:
    """Announces what was refused of real-time scheduling, each refusal once."""

    def __init__(self, scheduling: realtime.Scheduling, announcements: Announcements) -> None:
        self._scheduling, self._announcements = scheduling, announcements
        self._reported = 0

    def publish(self) -> None:
        """Announce and record what was refused since the last call."""
        new = self._scheduling.refusals[self._reported :]
        self._reported += len(new)
        for refusal in new:
            self._announcements.event(Event.REALTIME_UNAVAILABLE, refusal)


class Supervisor:
    """Watches a flight until its control thread is done."""

    def __init__(
        self,
        link: Link,
        control: ControlThread,
        worker: RequestWorker,
        engagement: Engagement,
        requests: Requests,
        *,
        slow_checks: Callable[[float], dict[Event, str]],
        streams: StreamRequests,
        feed: NotificationFeed,
        scheduling: SchedulingReport,
        announcements: Announcements,
        service: ServiceManager,
        timeout: float,
    ) -> None:
        """slow_checks: events present at a time, s, by the checks too slow for a tick. timeout: s of silence."""
        self._link, self._control, self._engagement, self._requests = link, control, engagement, requests
        self._slow_checks, self._streams, self._timeout = slow_checks, streams, timeout
        self._feed, self._scheduling, self._announcements = feed, scheduling, announcements
        self._worker, self._service = worker, service
        self._heard_since, self._reminded, self._landing_since = time.monotonic(), -float("inf"), float("inf")

    def serve(self) -> None:
        """Supervise until the control thread is done."""
        watch = StreamWatch(self._control, self._link)
        while not self._control.join(SUPERVISION_PERIOD):
            now = time.monotonic()
            self._service.progress(self._control.ticks)
            if standstill := watch.check(now):
                self._announcements.line(standstill)
            self._requests.slow_findings = self._slow_checks(now)
            self._scheduling.publish()
            self._feed.publish()
            self._await_readiness(now)
            self._remind_pilot(now)
            self._limit_landing(now)
        self._service.stopping()  # before the last request is answered, which may take longer than a watchdog waits
        self._worker.join(REQUEST_PATIENCE)
        self._feed.publish()

    def _await_readiness(self, now: float) -> None:
        """Ask for slow streams again, and give up waiting for a vehicle that is silent or not ready for too long."""
        connected = self._link.is_connected(now)
        if not connected:
            self._heard_since = now
        elif Event.RATES_LOW in self._requests.slow_findings:
            self._streams.repeat(now)
        engagement = self._engagement
        if engagement.state not in (State.DISCONNECTED, State.STANDBY) or not engagement.requested:
            return
        silence = now - self._link.status.last_heard
        if connected and now - self._heard_since > READINESS_PATIENCE:
            reason = engagement.refusal or "no estimate came"
        elif not connected and silence > self._timeout:
            reason = f"the vehicle has been silent for {silence:.0f} s"
        else:
            return
        self._requests.leave = self._requests.leave or f"not engaged: {reason}"

    def _remind_pilot(self, now: float) -> None:
        """Tell the pilot at the start of the wait, and again and again, that arming starts the flight."""
        if not self._engagement.awaits_pilot:
            self._reminded = -float("inf")
        elif now - self._reminded >= PILOT_REMINDER:
            self._reminded = now
            self._announcements.line("waiting for the pilot to arm: the vehicle takes off at once")
            self._link.send_text("alula: waits for arming, takes off at once", Severity.NOTICE)
        if self._engagement.awaits_pilot:
            self._heard_since = now  # what hinders from now on has the whole of its time to pass

    def _limit_landing(self, now: float) -> None:
        """Stop streaming where a landing that was requested takes too long."""
        if self._requests.leave:
            self._landing_since = min(self._landing_since, now)
        if now - self._landing_since > LANDING_PATIENCE:
            self._announcements.line(f"not landed within {LANDING_PATIENCE:g} s, LAND is requested")
            self._requests.stop = True
