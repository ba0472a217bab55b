"""Data sets: the segments of logs, divided into those that are fitted and those that are held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from diagnosis.data.command_curve import CommandCurve, fit_command_curve
from diagnosis.data.hold_out import divided, held_out_blocks, missing_motion
from diagnosis.data.inspected import doubt_note, inspected
from diagnosis.data.rotor_hold import find_hold
from diagnosis.data.segment import Segment, fast, segments, slow_quantities
from diagnosis.thresholds import DEFAULT, DatasetThresholds, SegmentThresholds, Thresholds
from dynamics.errors import DataError, RequestError
from dynamics.joined_logs import logs_are_joined
from dynamics.progress import Progress, no_progress, part_of
from dynamics.vehicle import Vehicle
from flights import Flight, Log, read_log
from flights.hold_out import matching
from flights.one_flight import read_one_flight
from flights.quality.findings import Finding
from flights.quantities import MOTION

NOTED = ("frozen_channel", "battery_unmeasured")  # findings that change what is used


@dataclass(frozen=True, eq=False)
class Dataset:
    """Segments to fit and segments held out.

    fitted: segments that parameters are fitted on.
    flight_of: the flight of each, numbered from 0.
    held_out: segments that models are judged on.
    hashes: sha256 of the logs that were fitted, by path.
    held_hashes: the same of logs that were held out whole.
    notes: what the user should know of the data.
    findings: of inspection, about the flights that were used.
    curve: thrust over command, where only commands were logged.
    """

    fitted: tuple[Segment, ...]
    flight_of: tuple[int, ...]
    held_out: tuple[Segment, ...]
    hashes: dict[str, str]
    notes: tuple[str, ...]
    findings: tuple[Finding, ...] = ()
    curve: CommandCurve | None = None
    held_hashes: dict[str, str] = field(default_factory=dict)

    @property
    def everything(self) -> tuple[Segment, ...]:
        """All segments."""
        return (*self.fitted, *self.held_out)


def read_dataset(
    logs: Sequence[str | Path],
    vehicle: Vehicle,
    *,
    hold_out: str | None = None,
    mapping: str | Path | None = None,
    pose: str | None = None,
    thresholds: Thresholds = DEFAULT,
    progress: Progress = no_progress,
) -> Dataset:
    """Read logs and set some aside: those whose file name matches hold_out, or a fifth.

    The last fifth of the flights; of a single one, or where the last ones do not move as the others do, blocks.

    pose: where their pose comes from, "mocap" or "estimator"; None: as the logs tell.

    Raises RequestError for logs that do not exist or a pattern that matches none or all of them, DataError when
    they hold too little.
    """
    reading = part_of(progress, 0.0, 0.9)
    flights = read_flights(logs, mapping=mapping, pose=pose, thresholds=thresholds.segment, progress=reading)
    progress(0.9, "inspection of the flights")
    return make_dataset(flights, vehicle, hold_out=hold_out, thresholds=thresholds)


def read_flights(
    logs: Sequence[str | Path],
    *,
    mapping: str | Path | None = None,
    pose: str | None = None,
    thresholds: SegmentThresholds = DEFAULT.segment,
    progress: Progress = no_progress,
) -> list[Flight]:
    """The flights of logs at one rate, that of the slowest. Raises RequestError and DataError as reading does.

    pose: as for `read_dataset`.
    """
    if not logs:
        raise RequestError("no log was given. Give the logs of one vehicle: alula diagnose LOG... --vehicle V.toml.")
    read = []
    if logs_are_joined():
        progress(0.0, f"reading {len(logs)} files of one flight")
        return align_logs([read_one_flight(logs, mapping=mapping, pose=pose)], thresholds)
    for number, path in enumerate(logs):
        progress(number / len(logs), f"reading {Path(path).name}")
        read.append(read_log(path, mapping=mapping, pose=pose))
    return align_logs(read, thresholds)


def align_logs(streams: Sequence[Log], thresholds: SegmentThresholds = DEFAULT.segment) -> list[Flight]:
    """The flights of logs that were read, at one rate, that of the slowest. Raises DataError as `read_flights`."""
    flights = [_flight(log, thresholds) for log in streams]
    rates = [flight.rate for flight in flights if flight.rate > 0]
    if not rates:
        names = ", ".join(flight.provenance.path for flight in flights[:3])
        raise DataError(f"{names}: one row is no flight. Fly at least 20 s in the air without gaps.")
    rate = min(rates)
    return [
        flight if flight.has_rate(rate) else Flight.from_log(log, rate=rate)
        for log, flight in zip(streams, flights, strict=True)
    ]


def _at_one_rate(flights: Sequence[Flight]) -> list[Flight]:
    """Flights at the rate of the slowest: windows are counted in rows, of which all must last as long."""
    rate = min((flight.rate for flight in flights if flight.rate > 0), default=0.0)
    return [flight if flight.has_rate(rate) else flight.at_rate(rate) for flight in flights]


def make_dataset(
    flights: Sequence[Flight], vehicle: Vehicle, *, hold_out: str | None = None, thresholds: Thresholds = DEFAULT
) -> Dataset:
    """The data set of flights, at the rate of the slowest. Raises as `read_dataset`."""
    distinct, notes = _distinct(_at_one_rate(flights))
    flights, findings = inspected(distinct, vehicle, thresholds)
    notes += doubt_note(distinct, flights, findings)
    flown = [(flight, parts) for flight in flights if (parts := segments(flight, vehicle, thresholds))]
    rate = flown[0][1][0].rate if flown else 0.0  # each has its own rounding
    flown = [(flight, tuple(replace(segment, rate=rate) for segment in parts)) for flight, parts in flown]
    notes += _left_out(flights, [flight for flight, _ in flown], thresholds.segment.min_duration, findings)
    notes += [finding.text for finding in findings if finding.name in NOTED]
    _require_one_source([parts for _, parts in flown])
    notes += [f"{f.provenance.path}: {damage}" for f in flights for damage in f.provenance.damage]
    notes += _missing(flights, thresholds.segment)
    limits = thresholds.dataset
    fitted, judged, held = _held_out(flown, hold_out, notes, thresholds)
    fitted = _enough_groups(fitted, limits)
    hashes, held_hashes = (
        {f.provenance.path: f.provenance.sha256 for i, (f, _) in enumerate(flown) if (i in held) is is_held}
        for is_held in (False, True)
    )
    flight_of = tuple(i for i, group in enumerate(fitted) for _ in group)
    to_fit, held_out = tuple(s for group in fitted for s in group), tuple(judged)
    curve = None
    if to_fit[0].rotor_source == "command":
        curve = fit_command_curve(to_fit, held_out, vehicle, thresholds.command_curve)
        notes.append(curve.note())
        to_fit, held_out = (tuple(curve.applied(s) for s in part) for part in (to_fit, held_out))
    hold = find_hold(to_fit, vehicle, thresholds.rotor_hold)
    if hold is not None:
        notes.append(hold.note())
        to_fit, held_out = (tuple(hold.applied(s) for s in part) for part in (to_fit, held_out))
    return Dataset(to_fit, flight_of, held_out, hashes, tuple(notes), findings, curve, held_hashes)


def _flight(log: Log, thresholds: SegmentThresholds) -> Flight:
    flight = Flight.from_log(log)
    return Flight.from_log(log, rate=thresholds.resampled_rate) if flight.rate > thresholds.max_rate else flight


def _left_out(
    flights: Sequence[Flight], flown: Sequence[Flight], min_duration: float, findings: Sequence[Finding]
) -> list[str]:
    """A note on flights without a segment. Raises DataError when none has one."""
    empty = [f.provenance.path for f in flights if not any(f is other for other in flown)]
    if not flown:
        reasons = "".join(f" {finding.text}." for finding in findings if finding.name == "frozen_channel")
        reasons += _mostly_missing(flights[0])
        raise DataError(
            f"{', '.join(empty[:3])}: nowhere {min_duration:g} s of uninterrupted flight.{reasons} Fly at least 20 s "
            "in the air without gaps."
        )
    if not empty:
        return []
    return [f"left out, for there are no {min_duration:g} s of uninterrupted flight in them: {', '.join(empty)}"]


def _mostly_missing(flight: Flight) -> str:
    """Which quantities of motion have no number in most rows of a flight, in words."""
    shares = {name: float(np.mean(~np.isfinite(flight[name]).all(axis=1))) for name in MOTION if flight.has(name)}
    return "".join(
        f" {name} holds no number in {share:.0%} of the rows." for name, share in shares.items() if share > 0.5
    )


def _distinct(flights: Sequence[Flight]) -> tuple[list[Flight], list[str]]:
    """Flights that are not copies of each other, with a note. Raises DataError when all are the same."""
    by_content: dict[bytes, Flight] = {}
    copies = []
    for flight in flights:
        key = b"".join(np.round(values, 6).tobytes() for values in flight.values.values())
        if key in by_content:
            copies.append(flight.provenance.path)
        by_content.setdefault(key, flight)
    if copies and len(by_content) == 1 and len(flights) > 1:
        raise DataError(f"all {len(flights)} flights are one and the same. Give different flights, or this one alone.")
    notes = [f"left out as copies of another flight: {', '.join(copies)}"] if copies else []
    return list(by_content.values()), notes


def _require_one_source(parts: Sequence[Sequence[Segment]]) -> None:
    """Raise DataError when some flights hold the rotors' speeds and others what was commanded."""
    by_source: dict[str, list[str]] = {}
    for segments_of_one in parts:
        first = segments_of_one[0]
        by_source.setdefault(first.rotor_source.replace("_", " "), []).append(Path(first.flight).name)
    if len(by_source) > 1:
        listed = "; ".join(f"{source}: {', '.join(names[:3])}" for source, names in by_source.items())
        raise DataError(
            f"the logs hold different quantities of their rotors ({listed}). Give logs of one kind, or leave the "
            "columns rotor_speed out of those that have them."
        )


def _missing(flights: Sequence[Flight], thresholds: SegmentThresholds) -> list[str]:
    """Notes on what was not logged, or too slowly, each with the flights that lack it if others do not."""
    lacking: dict[str, list[str]] = {}
    for flight in flights:
        for note in _missing_in(flight, thresholds):
            lacking.setdefault(note, []).append(Path(flight.provenance.path).name)
    return [
        note if len(names) == len(flights) else f"{note} (in {len(names)} of {len(flights)} flights: {names[0]} ...)"
        for note, names in lacking.items()
    ]


def _missing_in(flight: Flight, thresholds: SegmentThresholds) -> list[str]:
    def usable(*names: str) -> bool:
        return any(fast(flight, name, thresholds) for name in names)

    notes = [f"too slow to be used: {', '.join(slow)}" for slow in [slow_quantities(flight, thresholds)] if slow]
    if not usable("specific_force"):
        notes.append("no accelerometer in the log: a force cannot be distinguished from a fault of the pose")
    if not usable("rate"):
        notes.append("no gyro in the log: torques show only through the attitude, and gyro and clock stay unchecked")
    if not usable("attitude") or not usable("velocity", "position"):
        notes.append("no pose in the log: effects of speed and place do not show in gyro and accelerometer alone")
    return notes


def _held_out(
    flown: Sequence[tuple[Flight, tuple[Segment, ...]]], pattern: str | None, notes: list[str], thresholds: Thresholds
) -> tuple[list[list[Segment]], list[Segment], frozenset[int]]:
    """Segments to fit by flight, segments that are held out, and the places of flights that are so as a whole.

    Those that the pattern matches, or the last ones; blocks of all where there is one only or the last ones do not move
    as the others do. What was done is noted.
    """
    limits, parts = thresholds.dataset, [segments_of_one for _, segments_of_one in flown]
    if pattern is not None or len(flown) > 1:
        names = [Path(flight.provenance.path).name for flight, _ in flown]
        held = _held_out_flights(names, pattern, limits.held_out_share)
        fitted = [list(own) for i, own in enumerate(parts) if i not in held]
        judged = [s for i, own in enumerate(parts) if i in held for s in own]
        lacking = missing_motion([s for own in fitted for s in own], judged, limits)
        if pattern is not None or not lacking:
            return fitted, judged, held
        notes.append(
            f"the last flights have less {', '.join(lacking)} than the others: blocks of all flights are held out "
            "instead"
        )
    shortest = thresholds.segment.min_duration
    fitted, judged = divided(parts, held_out_blocks(parts, limits, shortest), shortest)
    fitted = [own for own in fitted if own]
    if not fitted or not judged:
        duration = sum(s.duration for own in parts for s in own)
        raise DataError(f"{duration:.0f} s of flight are too few to hold a part out. Fly at least 20 s.")
    if len(flown) == 1:
        spread = " and ".join(f"{s.start:.0f} to {s.start + s.duration:.0f} s" for s in judged)
        notes.append(
            f"one flight only: {spread} of it are held out, and effects that need different flights stay hidden"
        )
        fitted = _timed_groups(fitted[0], limits)
    return fitted, judged, frozenset()


def _held_out_flights(names: Sequence[str], pattern: str | None, share: float) -> frozenset[int]:
    """Places of the flights that are held out: those that the pattern matches, or the last ones."""
    if pattern is not None:
        return matching(names, pattern, option="--hold-out")
    count = max(1, round(share * len(names)))
    return frozenset(range(len(names) - count, len(names)))


def _timed_groups(parts: Sequence[Segment], thresholds: DatasetThresholds) -> list[list[Segment]]:
    """One flight's segments in groups of consecutive ones, each of about the same duration."""
    total = sum(len(s) for s in parts)
    count = max(1, int(total / parts[0].rate / thresholds.min_group))
    groups: list[list[Segment]] = [[] for _ in range(count)]
    passed = 0
    for segment in parts:
        groups[min(count - 1, int(count * (passed + len(segment) / 2) / total))].append(segment)
        passed += len(segment)
    return [group for group in groups if group]


def _enough_groups(groups: list[list[Segment]], thresholds: DatasetThresholds) -> list[list[Segment]]:
    """Groups with the longest cut in two until leaving one out is possible, or all are too short for it."""
    while len(groups) < thresholds.min_groups and (cut := _halved(groups, thresholds.min_part)) is not None:
        groups = cut
    return groups


def _halved(groups: list[list[Segment]], min_part: float) -> list[list[Segment]] | None:
    """Groups with the longest one cut in two, None when all are too short for it. min_part: s."""
    longest = max(range(len(groups)), key=lambda i: max(len(s) for s in groups[i]))
    group = groups[longest]
    if len(group) > 1:
        half = len(group) // 2
        return [*groups[:longest], group[:half], group[half:], *groups[longest + 1 :]]
    segment = group[0]
    if segment.duration < 2 * min_part:
        return None
    middle = len(segment) // 2
    halves = [[segment.between(0, middle)], [segment.between(middle, len(segment))]]
    return [*groups[:longest], *halves, *groups[longest + 1 :]]
