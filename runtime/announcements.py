"""The lines that a flight announces: to the caller, and the important ones to the ground station and the recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress

from runtime.control_thread import ControlThread, Notification
from runtime.flight.engagement import Transition
from runtime.flight.events import POLICIES, Event, EventChange, Severity, event_text
from runtime.link.link import Link
from runtime.record.recorder import Recorder
from runtime.record.records import EventRecord
from runtime.request_worker import RequestWorker
from runtime.service_manager import ServiceManager
from runtime.telemetry_buffer import TelemetryBuffer

Announce = Callable[[str], None]


class Announcements:
    """Publishes what happens, each line with the time since the start.

    started: s, monotonic.
    recorder: of the flight, None for none.
    """

    def __init__(self, publish_line: Announce) -> None:
        self.started = time.monotonic()
        self.recorder: Recorder | None = None
        self._publish_line = publish_line

    def line(self, text: str, at: float | None = None) -> None:
        """Publish a line. at: when it happened, s, monotonic; None for now."""
        with suppress(OSError, ValueError):  # a terminal or pipe that is closed ends no flight
            self._publish_line(f"{(at or time.monotonic()) - self.started:8.2f} s  {text}")

    def event(self, event: Event, detail: str) -> None:
        """Announce and record an event that no tick raises."""
        now, text = time.monotonic(), event_text(event, detail)
        self.line(text)
        if self.recorder is not None:
            self.recorder.put(EventRecord(now, event.value, True, int(POLICIES[event].severity), text), now)


class NotificationFeed:
    """Announces what link, vehicle and control thread report during a flight."""

    def __init__(
        self,
        announcements: Announcements,
        link: Link,
        telemetry: TelemetryBuffer,
        control: ControlThread,
        worker: RequestWorker,
        service: ServiceManager,
    ) -> None:
        self._announcements, self._link, self._telemetry = announcements, link, telemetry
        self._control, self._worker, self._service = control, worker, service

    def publish(self) -> None:
        """Announce all that is new."""
        while self._telemetry.notifications:
            event = self._telemetry.notifications.popleft()
            self._announcements.line(f"link: {event.text}", event.time)
        while self._telemetry.texts:
            self._announcements.line(f"vehicle: {self._telemetry.texts.popleft()}")
        while not self._control.notifications.empty():
            self._publish_notification(self._control.notifications.get())

    def _publish_notification(self, notification: Notification) -> None:
        link, announce = self._link, self._announcements.line
        match notification:
            case Transition():
                refusal = f" ({self._worker.refusal})" if self._worker.refusal else ""
                announce(f"{notification}{refusal}", notification.time)
                self._service.status(f"{notification}{refusal}")
                link.send_text(f"alula: {notification.after.value}: {notification.reason}", Severity.NOTICE)
            case EventChange():
                policy = POLICIES[notification.event]
                word = "" if notification.active else "over: "
                announce(f"{word}{notification.text}", notification.time)
                if notification.active and policy.severity <= Severity.NOTICE:
                    link.send_text(f"alula: {notification.text}", policy.severity)
            case str():
                announce(notification)
                link.send_text(f"alula: {notification}", Severity.WARNING)
