"""The health of a log: channels read, statements made, put in order, and told in two sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from dynamics.errors import AlulaError
from flights.events import cleaned
from flights.health import ardupilot, px4
from flights.health.answer import Health, HealthEvent, Level, Statement
from flights.health.estimator import gps_statements, rejection_statements, reported_statements, reset_statements
from flights.health.motion import (
    ends_in_air,
    impact_statement,
    leaning_statement,
    oscillation_statements,
    raw_vibration,
    upset_statement,
    vibration_statements,
)
from flights.health.power import battery_statements, margin_statements
from flights.health.record import AutopilotSeries, Record, build_record
from flights.health.rotors import balance_statements, lost_control, stopped_statement
from flights.log import Log
from flights.reading import opened_log

ORDER: Sequence[Level] = ("fault", "warning", "note")
SAME_TIME = 1.0  # s within which a cause comes before what it makes happen
SHOWN = 3  # further things in a sentence
# what makes other things happen comes before what follows from it, where both begin at once
CAUSES = ("esc_failure", "stopped_rotor", "weak_thrust", "reported_fd_motor", "voltage_sag", "battery_low", "gps_lost",
          "oscillation", "vibration", "clipping", "impact", "rejects_", "saturation", "lost_control",
          "reported_")  # fmt: skip
READERS = {"PX4 ULog": px4.read, "ArduPilot DataFlash log": ardupilot.read}


def read_health(log: Log) -> Health:
    """The answer about a log; an autopilot's file is read again, for what it says of itself."""
    reader = READERS.get(log.provenance.format)
    autopilot = AutopilotSeries()
    if reader is not None:
        try:
            with opened_log(Path(log.provenance.path)) as source:
                autopilot = reader(source.file, log.start)
        except AlulaError:  # what the flight's own streams say remains
            autopilot = AutopilotSeries()
    return judge_health(build_record(log, autopilot))


def judge_health(record: Record) -> Health:
    """The answer about one flight's channels."""
    with np.errstate(all="ignore"):
        statements = _statements(record)
    events = _events(record, statements)
    acute, throughout = _who_gave_up(record, statements)
    defects = [*acute, *throughout]
    advice = dict.fromkeys(s.advice for s in (*_by_level(defects), *statements) if s.advice)
    return Health(
        sentences=_sentences(record, statements, defects),
        advice=tuple(advice),
        first=defects[0].name if defects else "",
        statements=tuple(_by_level(_in_order(statements))),
        events=events,
        unknown=_unknown(record),
        in_air=round(record.in_air, 1),
    )


def _statements(record: Record) -> list[Statement]:
    if not record.flights:
        return [*reported_statements(record)]
    lost, blow = lost_control(record), impact_statement(record)
    is_blow = blow is not None and blow.level != "note"
    calm = record.until(min(lost[0] - 0.5 if lost else np.inf, blow.start - 0.1 if blow and is_blow else np.inf))
    stopped = stopped_statement(record)
    statements = [
        *balance_statements(calm),
        *margin_statements(calm),
        *battery_statements(calm),
        *oscillation_statements(calm),
        *vibration_statements(calm),
        *rejection_statements(calm),
        *reset_statements(calm),
        *gps_statements(calm),
        *reported_statements(record),
    ]
    statements += [s for s in (stopped, upset_statement(record), blow, raw_vibration(calm)) if s]
    statements += [s for s in (leaning_statement(record), ends_in_air(record)) if s]
    if stopped is not None:  # the same rotor's imbalance and limit are this
        statements = [s for s in statements if s is stopped or s.name not in ("weak_thrust", "saturation", "imbalance")]
    return statements


def _rank(statement: Statement) -> int:
    return next((place for place, name in enumerate(CAUSES) if statement.name.startswith(name)), len(CAUSES))


def _in_order(statements: Iterable[Statement]) -> list[Statement]:
    """In the order of time; of those that begin together with the first, its cause comes first."""
    ordered = sorted(statements, key=lambda s: s.start)
    if not ordered:
        return []
    together = [s for s in ordered if s.start <= ordered[0].start + SAME_TIME]
    first = min(together, key=_rank)
    return [first, *(s for s in ordered if s is not first)]


def lasts(record: Record, statement: Statement) -> bool:
    """Whether a statement is about the whole flight, and no event of it."""
    evidence = statement.evidence
    return evidence.start <= record.start + 4.0 and evidence.end - evidence.start > 0.7 * (record.end - record.start)


def _who_gave_up(record: Record, statements: Sequence[Statement]) -> tuple[list[Statement], list[Statement]]:
    """Defects that are events, in order, and those that last throughout, the worst first."""
    defects = [s for s in statements if s.level != "note"]
    throughout = [s for s in defects if lasts(record, s)]
    return _in_order(s for s in defects if s not in throughout), _by_level(_in_order(throughout))


def _by_level(statements: Sequence[Statement]) -> list[Statement]:
    return sorted(statements, key=lambda s: ORDER.index(s.level))


def _sentences(record: Record, statements: Sequence[Statement], defects: Sequence[Statement]) -> tuple[str, str]:
    if not record.flights:
        return (
            "The vehicle did not fly in this log.",
            "So nothing can be told about its rotors, battery under load or control.",
        )
    flown = f"{record.in_air:.0f} s in the air"
    if not defects:
        return (f"Nothing in this log departs from healthy flights in {flown}.", _rest(record, statements))
    events, throughout = _who_gave_up(record, statements)
    if not events:
        shown = "; ".join(f"{_certainly(s)}{s.text if s is throughout[0] else _short(s)}" for s in throughout[:SHOWN])
        return (f"Throughout the flight of {flown}: {shown}.", _rest(record, statements))
    text = f"First, {_certainly(events[0])}{events[0].text}"
    if len(events) > 1:
        text += "; then " + "; ".join(f"{_certainly(s)}{_short(s)}" for s in events[1 : 1 + SHOWN])
    if throughout:
        text += "; throughout, " + "; ".join(_short(s) for s in throughout[:SHOWN])
    return (f"{text}.", _rest(record, statements))


def _short(statement: Statement) -> str:
    """A statement without its explanation."""
    return statement.text.partition(": ")[0]


def _certainly(statement: Statement) -> str:
    return {"seen": "", "likely": "likely ", "cannot tell": "and here the log cannot tell which: "}[statement.certainty]


def _rest(record: Record, statements: Sequence[Statement]) -> str:
    """The second sentence: what is as in healthy logs, and what cannot be told."""
    healthy = [
        s.text
        for s in statements
        if s.level == "note" and s.name in ("balance", "margin", "battery", "vibration_level")
    ]
    notes = [s.text for s in statements if s.level == "note" and s.name in ("no_gps_fix", "ends_in_air")]
    unknown = _unknown(record)
    parts = ([f"As in healthy logs: {'; '.join(healthy)}"] if healthy else []) + (
        [f"noted: {'; '.join(notes)}"] if notes else []
    )
    if unknown:
        parts.append(f"not told by this log: {', '.join(unknown)}")
    text = "; ".join(parts) or "nothing else departs from healthy logs"
    return f"{text[0].upper()}{text[1:]}."


def _unknown(record: Record) -> tuple[str, ...]:
    missing = []
    if record.commands() is None:
        balance = "" if record.values("rotor_speed") is not None else "balance and "
        missing.append(f"{balance}margin of the rotors (no motor outputs)")
    if record.values("battery_voltage") is None and record.autopilot.pack_voltage is None:
        missing.append("the battery (no voltage)")
    if not record.autopilot.vibration and record.values("specific_force") is None:
        missing.append("vibration (no accelerometer)")
    if not record.autopilot.test_ratios:
        missing.append("the estimator's innovations")
    return tuple(missing)


def _events(record: Record, statements: Sequence[Statement]) -> tuple[HealthEvent, ...]:
    events = [*record.autopilot.events]
    has_modes = any(event.name == "mode" for event in events)
    for event in record.log.events:
        if event.kind == "mode" and not has_modes:
            events.append(HealthEvent(event.time, "mode", f"mode {event.text}", record.log.provenance.format))
        elif event.kind == "message" and not event.text.startswith(("INFO: [logger]", "INFO: [tone_alarm]")):
            events.append(HealthEvent(event.time, "message", event.text, "logged message"))
    events += [HealthEvent(s.start, s.name, _short(s), s.evidence.channel) for s in statements if s.level != "note"]
    events += [
        HealthEvent(s.start, s.name, s.text, s.evidence.channel) for s in statements if s.name.endswith("_reset")
    ]
    unique = {
        (round(e.time, 2), e.text): HealthEvent(round(e.time, 3), e.name, cleaned(e.text), e.source) for e in events
    }
    return tuple(sorted(unique.values(), key=lambda e: e.time))
