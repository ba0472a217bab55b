"""Inspection of a log: its channels, its defects, and the effects that it can identify."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from dynamics.effect import Effect
from dynamics.effects import CATALOGUE
from dynamics.excitation import DRIVE, MEASURES, WRENCH
from flights.assembly import EMPTY
from flights.delays import MAX_REACH, Delay, estimate_delays
from flights.exclusion import Exclusion, excluded_rows, find_exclusions
from flights.flight import Flight
from flights.log import Log, Repair, UnusedStream
from flights.pose_source import PoseSource
from flights.quality import advice
from flights.quality.channels import Channel, channel_findings, channels_of
from flights.quality.declared import declared_wrong, flying_streams
from flights.quality.excitation import Coverage, Measure, coverages, measures
from flights.quality.findings import Finding
from flights.quality.identifiable import EffectAnswer, answers
from flights.quality.propeller_imbalance import imbalance_findings
from flights.quality.rotor_balance import rotor_findings
from flights.quantities import MOTION, PRIMARY, RESET_COUNTERS
from flights.readers.bag_clocks import CLOCK_STEP, OTHER_CLOCK
from flights.readers.csv import TIME_UNIT
from flights.reading import read_log

Verdict = Literal["good", "limited", "unusable"]

MIN_FLIGHT = 5.0  # s of free flight that can answer anything
MIN_ROTOR_RATE = 40.0  # Hz: what the lag of a small vehicle's motors needs, and the regression's own rate
GOOD_ROTOR_RATE = 95.0
MIN_MOTION_RATE = 40.0
NOTABLE_DELAY = 0.002  # s
GOOD_SHARE = 0.6  # of the effects


class Inspection(msgspec.Struct, frozen=True):
    """The inspection of one log. Times are s since the log's start.

    verdict: unusable when the data identifies no effect.
    sentence: the verdict with its reason.
    duration: of the log, s.
    free_flight: sum of the segments, s.
    segments: of free flight, start and end, s.
    exclusions: segments that are not free flight.
    delays: of streams and of responses.
    pose_source: whether the pose is motion capture's or an estimator's, as far as the log tells.
    excitation, coverage: how much the flight moves, and where its time was spent.
    unused: numbers of the log that may be one of a flight's quantities and are not used as one.
    inferences: those of the notes on ranges, units and orders as they were understood, and on what that rests.
    """

    path: str
    format: str
    sha256: str
    verdict: Verdict
    sentence: str
    duration: float
    free_flight: float
    segments: tuple[tuple[float, float], ...]
    exclusions: tuple[Exclusion, ...]
    channels: tuple[Channel, ...]
    delays: tuple[Delay, ...]
    pose_source: PoseSource
    excitation: tuple[Measure, ...]
    coverage: tuple[Coverage, ...]
    effects: tuple[EffectAnswer, ...]
    findings: tuple[Finding, ...]
    advice: tuple[str, ...]
    notes: tuple[str, ...]
    repairs: tuple[Repair, ...]
    unused: tuple[UnusedStream, ...] = ()
    inferences: tuple[str, ...] = ()


def inspect_log(path: str | Path, *, mapping: str | Path | None = None) -> Inspection:
    """Inspect a log's file. Raises RequestError and DataError as `read_log` does; a poor log is no error."""
    return judge(read_log(path, mapping=mapping))


def judge(log: Log, catalogue: Mapping[str, Effect] = CATALOGUE) -> Inspection:
    """Inspect a log. Raises DataError when there is nothing to align.

    catalogue: the effects that might be identified from it.
    """
    flight = Flight.from_log(log)
    exclusions = find_exclusions(flight)
    segments = flight.segments(exclude=excluded_rows(flight, exclusions))
    flying = tuple((float(segment.time[0]), float(segment.time[-1])) for segment in segments)
    delays = estimate_delays(log, exclusions=exclusions)
    measured = measures(segments, ground=_ground_height(flight, exclusions))
    usable = _usable(log)
    findings = [
        *(declared_wrong(log.streams) or declared_wrong(flying_streams(flight, segments))),
        *_mended_clocks(log),
        *_actuation(log),
        *_accelerations(log),
        *_empty(log),
        *_amount(measured, log),
        *_clocks(delays),
        *_resets(log),
        *rotor_findings(segments),
        *imbalance_findings(log, flying),
        *channel_findings(log, flying),
    ]
    untrusted = _untrusted(findings) | _unused(log)
    effects = answers(_trusted(usable, findings), measured, catalogue, untrusted=untrusted)
    verdict = _verdict(findings, effects)
    return Inspection(
        path=log.provenance.path,
        format=log.provenance.format,
        sha256=log.provenance.sha256,
        verdict=verdict,
        sentence=_sentence(verdict, findings, effects, measured),
        duration=round(log.duration, 3),
        free_flight=round(measured["duration"], 3),
        segments=flying,
        exclusions=exclusions,
        channels=channels_of(log),
        delays=delays,
        pose_source=flight.pose_source,
        excitation=tuple(Measure(name, value, MEASURES[name]) for name, value in measured.items()),
        coverage=coverages(segments),
        effects=effects,
        findings=tuple(sorted(findings, key=lambda finding: ("error", "warning", "note").index(finding.severity))),
        advice=tuple(dict.fromkeys(f.advice for f in findings if f.advice and f.severity != "note")),
        notes=log.provenance.notes,
        repairs=log.provenance.repairs,
        unused=log.provenance.unused,
        inferences=log.provenance.inferences,
    )


def _ground_height(flight: Flight, exclusions: Sequence[Exclusion]) -> float:
    """Where the vehicle stood, m; the height of the origin when it never stood in this log."""
    standing = excluded_rows(flight, [item for item in exclusions if item.reason == "ground"])
    if not flight.has("position") or not np.isfinite(flight["position"][standing, 2]).any():
        return 0.0
    return float(np.nanmedian(flight["position"][standing, 2]))


def _usable(log: Log) -> set[str]:
    """Quantities that are logged fast enough, and the velocity where the position gives it."""
    slow = dict.fromkeys(WRENCH, MIN_ROTOR_RATE) | {"rate": MIN_MOTION_RATE}
    rates = {name: stream.rate for name in log.names if (stream := log.stream(name)) is not None}
    usable = {name for name, rate in rates.items() if rate >= slow.get(name, 0.0)}
    return usable | {"velocity"} if rates.get("position", 0.0) >= MIN_ROTOR_RATE else usable


def _trusted(usable: set[str], findings: Sequence[Finding]) -> set[str]:
    """The usable quantities without a battery whose voltage stands still."""
    stuck = _is_battery_frozen(findings)
    return usable - {"battery_voltage"} if stuck else usable


def _untrusted(findings: Sequence[Finding]) -> dict[str, str]:
    """Why a quantity that is logged is not used, by quantity."""
    return {"battery_voltage": "which is logged but stands still"} if _is_battery_frozen(findings) else {}


def _unused(log: Log) -> dict[str, str]:
    """Why a quantity is not used that the log may hold, by quantity."""
    names = {unused.quantity for unused in log.provenance.candidates(PRIMARY)} - set(log.names)
    return dict.fromkeys(names, "which this log may hold and does not name")


def _is_battery_frozen(findings: Sequence[Finding]) -> bool:
    return any(f.name == "frozen_channel" and f.text.startswith("battery_voltage") for f in findings)


def _mended_clocks(log: Log) -> list[Finding]:
    """Stamps that the reader had to change: topics of a bag by another clock, a clock that was set, another unit."""
    one_clock = "stamp all sensors by one clock (chrony, timesync)"
    advice = {
        OTHER_CLOCK: one_clock,
        CLOCK_STEP: one_clock,
        TIME_UNIT: "write seconds, or map the column with its unit",
    }
    made = [repair for repair in log.provenance.repairs if repair.name in advice]
    return [Finding("warning", repair.name, repair.detail, advice[repair.name]) for repair in made]


def _actuation(log: Log) -> list[Finding]:
    """Whether rotor speeds or commands are logged, and fast enough."""
    form, parameters = log.provenance.format, log.parameters
    rates = {name: stream.rate for name in WRENCH if (stream := log.stream(name)) is not None}
    faster = advice.faster_rotors(form, parameters)
    candidates = log.provenance.candidates(WRENCH)
    if not rates and candidates:
        text = f"no rotor speeds or commands are used of this log, though it may hold them: {_named(candidates)}"
        return [Finding("error", "rotors_unused", text, advice.unused_rotors(form), fatal=True)]
    if not rates:
        text = "neither rotor speeds nor commands are in this log"
        return [Finding("error", "no_rotors", text, faster, fatal=True)]
    best = max(rates, key=lambda name: rates[name])
    text = f"{best} is logged at {rates[best]:.0f} Hz"
    if rates[best] < MIN_ROTOR_RATE:
        return [
            Finding(
                "error",
                "rotors_too_slow",
                f"{text}, wanted {MIN_ROTOR_RATE:.0f} Hz at least: nothing about rotors or "
                "moments can be estimated from it",
                faster,
                fatal=True,
            )
        ]
    findings = []
    if rates[best] < GOOD_ROTOR_RATE:
        findings.append(Finding("warning", "rotors_slow", f"{text}; 100 Hz or more would identify more", faster))
    if "rotor_speed" not in rates and best in DRIVE:
        findings.append(
            Finding(
                "note",
                "commands_only",
                f"{best} is a command: its gain and lag are further unknowns of every fit",
                advice.measured_speeds(form),
            )
        )
    return findings


def _named(candidates: Sequence[UnusedStream]) -> str:
    return "; ".join(map(str, candidates))


def _accelerations(log: Log) -> list[Finding]:
    """Accelerations that are in the log and not used, where none are."""
    candidates = log.provenance.candidates(("specific_force",))
    if not candidates or log.stream("specific_force") is not None:
        return []
    text = f"no specific force is used of this log, though it may hold one: {_named(candidates)}"
    advised = "log it calibrated and in the body's axes, or write a table with a column mapping"
    return [Finding("warning", "force_unused", text, advised)]


def _empty(log: Log) -> list[Finding]:
    """Columns without a number anywhere: what needs them finds no flight."""
    findings = []
    for stream in map(log.stream, log.names):
        if stream is None or not len(stream.values):
            continue
        empty = [name for name, column in zip(stream.columns, stream.values.T, strict=True) if np.isnan(column).all()]
        if empty:
            findings.append(
                Finding(
                    "error" if stream.name in MOTION else "warning",
                    "empty_column",
                    f"{' and '.join(empty)} {'holds' if len(empty) == 1 else 'hold'} no number at all",
                    f"write {stream.name} again from the original log, or leave its columns out",
                    fatal=stream.name in MOTION,
                )
            )
    return findings


def _amount(measured: dict[str, float], log: Log) -> list[Finding]:
    if measured["duration"] >= MIN_FLIGHT:
        return []
    empty = "".join(f"; {note}" for note in log.provenance.notes if note.endswith(EMPTY))
    return [
        Finding(
            "error",
            "no_flight",
            f"only {measured['duration']:.1f} s of free flight are in this log, wanted {MIN_FLIGHT:.0f} s at "
            f"least{empty}",
            "fly longer, and log velocity, attitude and body rates without gaps",
            fatal=True,
        )
    ]


def _clocks(delays: Sequence[Delay]) -> list[Finding]:
    clocks = [delay for delay in delays if not delay.is_response]
    late = [d for d in clocks if d.is_known and abs(d.seconds) > NOTABLE_DELAY and not d.low <= 0.0 <= d.high]
    findings = [
        Finding("note", "clock_offset", str(delay), "nothing: it is removed before a model is compared or fitted")
        for delay in late
    ]
    return findings + [
        Finding(
            "note",
            "uncertain_delay",
            f"{delay}: less certain than {1e3 * MAX_REACH:.0f} ms, so that it is not removed",
            "fly more briskly, and where the air is still: gusts mask the rotors' response",
        )
        for delay in clocks
        if not delay.is_known
    ]


def _resets(log: Log) -> list[Finding]:
    findings = []
    for name in RESET_COUNTERS:
        stream = log.stream(name)
        count = 0 if stream is None else int((stream.values[1:, 0] != stream.values[:-1, 0]).sum())
        if count:
            findings.append(Finding("note", "estimator_reset", f"{name} changed {count} times; segments end there"))
    return findings


def _verdict(findings: Sequence[Finding], effects: Sequence[EffectAnswer]) -> Verdict:
    if any(finding.fatal for finding in findings):
        return "unusable"
    if not any(effect.answer != "no" for effect in effects):
        return "unusable"
    share = sum(effect.answer == "yes" for effect in effects) / len(effects)
    poor = any(finding.severity == "error" for finding in findings)
    return "good" if share >= GOOD_SHARE and not poor else "limited"


def _sentence(
    verdict: Verdict, findings: Sequence[Finding], effects: Sequence[EffectAnswer], measured: dict[str, float]
) -> str:
    yes = sum(effect.answer == "yes" for effect in effects)
    weakly = sum(effect.answer == "weakly" for effect in effects)
    summary = (
        f"{measured['duration']:.0f} s of free flight can identify {yes} of {len(effects)} effects, and {weakly} "
        "more weakly"
    )
    worst = next((finding for finding in findings if finding.severity == "error"), None)
    if verdict == "unusable":
        return f"This log is unusable: {worst.text if worst is not None else 'no effect is excited'}."
    if worst is not None:
        return f"This log is of limited use: {worst.text}. {summary}."
    return f"This log is good: {summary}." if verdict == "good" else f"This log is of limited use: {summary}."
