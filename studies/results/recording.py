"""A recording of `alula fly`: tracking, timing, health, events, and what the model followed in flight."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diagnosis.thresholds import DEFAULT
from runtime.record.recording import damage_named, newest_recording
from runtime.record.records import EventRecord, StateRecord
from studies.results.kinds import RECORDING
from studies.results.recorded_flight import RecordedFlight, read_flight_record
from studies.results.recording_pictures import health_picture, quantiles, timing_picture, tracking_picture
from studio.pages.figure import Picture
from studio.pages.followed import followed_picture
from studio.pages.shown import Shown
from studio.pages.tables import Cell, PageTable

SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
NO_FALLBACK = "none"


def show(path: Path) -> Shown:
    """The flight. Raises RequestError and DataError for a file that is no recording of `alula fly`."""
    path = newest_recording(path)
    with damage_named(path):
        return _shown(read_flight_record(path))


def _shown(flight: RecordedFlight) -> Shown:
    return Shown(
        RECORDING,
        f"Flight of {flight.recording.metadata.get('reference', 'a reference')}, {flight.path.name}",
        _lines(flight),
        pictures=_pictures(flight),
        tables=[table for make in TABLES if (table := make(flight)).rows],
        logs={flight.path.name: flight.path},
        command=f"alula replay {flight.path}",
        replayable=True,
    )


def _pictures(flight: RecordedFlight) -> dict[str, Picture]:
    drawn = {
        "Tracking": tracking_picture(flight) if len(flight.time) else None,
        "Followed in flight": None if flight.followed is None else followed_picture(flight.followed),
        "Timing": timing_picture(flight),
        "Health": health_picture(flight),
    }
    return {title: one for title, one in drawn.items() if one is not None}


def _lines(flight: RecordedFlight) -> list[str]:
    recording, ticks = flight.recording, flight.ticks
    lines = []
    tracked = flight.distance[flight.tracked]
    if len(tracked):
        rmse, largest = 100 * np.sqrt(np.mean(tracked**2)), 100 * tracked.max()
        lines.append(f"Position error while it tracked: {rmse:.1f} cm RMS, {largest:.1f} cm at most, by its estimate.")
    else:
        lines.append("The reference was not tracked.")
    late = Counter(str(cause) for cause in ticks["late_cause"] if cause)
    listed = f" ({', '.join(f'{cause} {count}' for cause, count in late.most_common())})" if late else ""
    median, _, slow, _ = quantiles(1e3 * ticks["departure_seconds"])
    lines.append(
        f"{len(flight.tick_time):,} ticks in {flight.tick_time[-1]:.0f} s, {sum(late.values())} late{listed}; from "
        f"trigger to setpoint {median:.2g} ms in the median, {slow:.2g} ms in the slowest hundredth."
    )
    fallback = float(np.mean(ticks["fallback"] != NO_FALLBACK))
    if fallback:
        lines.append(f"A fallback flew in {100 * fallback:.2g} % of the ticks.")
    raised = Counter(row["name"] for row in flight.rows(EventRecord) if row["active"])
    if raised:
        lines.append("Events: " + ", ".join(f"{name} {count}" for name, count in raised.most_common()) + ".")
    if not recording.complete:
        lines.append("The recording was cut off; everything up to there is shown.")
    return lines


def _timing(flight: RecordedFlight) -> PageTable:
    headings = ("duration, ms", "median", "95 %", "99 %", "largest")
    fields = {
        "feedback_seconds": "feedback: estimate in, setpoint out",
        "preparation_seconds": "preparation of the next tick",
        "departure_seconds": "trigger to the setpoint's departure",
        "estimate_age": "age of the estimate at its use",
    }
    rows: list[Sequence[Cell]] = [
        (name, *(1e3 * value for value in quantiles(flight.ticks[field]))) for field, name in fields.items()
    ]
    return PageTable("Timing of the ticks", headings, rows)


def _followed(flight: RecordedFlight) -> PageTable:
    """Values at first, and at the end of tracking, which is the end of what the flight shows of them."""
    rows: list[Sequence[Cell]] = []
    if (followed := flight.followed) is not None:
        for name, last in followed.values.items():
            first = followed.value[:, followed.names.index(name)]
            half = DEFAULT.in_flight.interval * last.std
            interval = f"{last.value - half:.3g} to {last.value + half:.3g}"
            rows.append((name, float(first[np.isfinite(first)][0]), last.value, interval))
    note = "SI units. At the end of tracking, or of the recording."
    return PageTable("Followed in flight", ("parameter", "at first", "at the end", "95 % interval"), rows, note)


def _events(flight: RecordedFlight) -> PageTable:
    rows = [
        (row["time"], row["name"], "raised" if row["active"] else "cleared", _severity(row["severity"]), row["text"])
        for row in flight.rows(EventRecord)
    ]
    return PageTable("Events", ("time, s", "event", "", "severity", "in words"), rows, digits=5)


def _severity(number: int) -> str:
    return SEVERITIES[number] if 0 <= number < len(SEVERITIES) else str(number)


def _states(flight: RecordedFlight) -> PageTable:
    rows = [(row["time"], row["before"], row["after"], row["reason"]) for row in flight.rows(StateRecord)]
    return PageTable("States", ("time, s", "from", "to", "reason"), rows, digits=5)


TABLES = (_timing, _followed, _events, _states)
