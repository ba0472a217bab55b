"""Logs into the segments that are fitted and those that are held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from diagnosis.data.command_curve import fit_command_curve
from diagnosis.data.segment import FASTEST, Segment, fast, segments, slow_ones
from dynamics.errors import DataError, RequestError
from dynamics.vehicle import Vehicle
from flights import Flight, read_log

HELD_OUT_SHARE = 0.2
MIN_FLIGHTS = 4  # that leaving one out needs; fewer are cut into parts
PART = 6.0  # s, the shortest such part
RESAMPLED = 250.0  # Hz, for logs that are faster than needed


@dataclass(frozen=True, eq=False)
class Dataset:
    """fitted: segments to learn from, flight_of: their flights, numbered from 0. held_out: segments to judge on.

    hashes: sha256 of the logs that were fitted, by path. notes: what the user should know of the data.
    """

    fitted: tuple[Segment, ...]
    flight_of: tuple[int, ...]
    held_out: tuple[Segment, ...]
    hashes: dict[str, str]
    notes: tuple[str, ...]

    @property
    def everything(self) -> tuple[Segment, ...]:
        """All segments."""
        return (*self.fitted, *self.held_out)


def read_dataset(
    logs: Sequence[str | Path], vehicle: Vehicle, *, hold_out: str | None = None, mapping: str | Path | None = None
) -> Dataset:
    """Read logs and set some aside: those whose file name matches hold_out, or the last fifth.

    Raises RequestError for logs that cannot be found or a pattern that matches none or all of them, DataError when
    they hold too little.
    """
    return make_dataset(read_flights(logs, mapping=mapping), vehicle, hold_out=hold_out)


def read_flights(logs: Sequence[str | Path], *, mapping: str | Path | None = None) -> list[Flight]:
    """The flights of logs at one rate, that of the slowest. Raises RequestError and DataError as reading does."""
    if not logs:
        raise RequestError("no log was given. Give the logs of one vehicle: alula diagnose LOG... --vehicle V.toml.")
    flights = [_read(path, mapping) for path in logs]
    rate = round(min(flight.rate for flight in flights), 3)
    same = [abs(flight.rate - rate) < 0.01 * rate for flight in flights]
    return [
        flight if good else Flight.read(path, mapping=mapping, rate=rate)
        for path, flight, good in zip(logs, flights, same, strict=True)
    ]


def make_dataset(flights: Sequence[Flight], vehicle: Vehicle, *, hold_out: str | None = None) -> Dataset:
    """The data set of flights at one rate. Raises as `read_dataset`."""
    flights, notes = _distinct(flights)
    parts = [segments(flight, vehicle) for flight in flights]
    empty = [f.provenance.path for f, p in zip(flights, parts, strict=True) if not p]
    if len(empty) == len(flights):
        raise DataError(
            f"{', '.join(empty[:3])}: nowhere 3 s of uninterrupted flight. Fly at least 20 s in the air without gaps."
        )
    if empty:
        notes.append(f"left out, for there are no 3 s of uninterrupted flight in them: {', '.join(empty)}")
    flown = [(f, p) for f, p in zip(flights, parts, strict=True) if p]
    _require_one_source([p for _, p in flown])
    notes += _missing(flights[0])
    held = _held_out([Path(f.provenance.path).name for f, _ in flown], hold_out)
    if len(flown) == 1:
        fitted, judged = _split_in_time(flown[0][1])
        notes.append("one flight only: its last fifth is held out, and effects that need different flights stay hidden")
    else:
        fitted = [list(p) for i, (_, p) in enumerate(flown) if i not in held]
        judged = [s for i, (_, p) in enumerate(flown) if i in held for s in p]
    while len(fitted) < MIN_FLIGHTS and (cut := _halved(fitted)) is not None:
        fitted = cut
    hashes = {f.provenance.path: f.provenance.sha256 for i, (f, _) in enumerate(flown) if i not in held}
    numbered = [(s, i) for i, group in enumerate(fitted) for s in group]
    flight_of = tuple(i for _, i in numbered)
    learned, kept_back = tuple(s for s, _ in numbered), tuple(judged)
    if learned[0].rotor_source == "command":
        curve = fit_command_curve(learned, kept_back, vehicle)
        notes.append(str(curve))
        learned, kept_back = (tuple(curve.applied(s, vehicle) for s in part) for part in (learned, kept_back))
    return Dataset(learned, flight_of, kept_back, hashes, tuple(notes))


def _read(path: str | Path, mapping: str | Path | None) -> Flight:
    log = read_log(path, mapping=mapping)
    flight = Flight.from_log(log)
    return Flight.from_log(log, rate=RESAMPLED) if flight.rate > FASTEST else flight


def _distinct(flights: Sequence[Flight]) -> tuple[list[Flight], list[str]]:
    """Flights that are not copies of each other, with a note. Raises DataError when all are the same."""
    seen: dict[bytes, Flight] = {}
    copies = []
    for flight in flights:
        key = b"".join(np.round(flight.columns[name], 6).tobytes() for name in flight.columns)
        if key in seen:
            copies.append(flight.provenance.path)
        seen.setdefault(key, flight)
    if copies and len(seen) == 1 and len(flights) > 1:
        raise DataError(f"all {len(flights)} flights are one and the same. Give different flights, or this one alone.")
    return list(seen.values()), [f"left out as copies of another flight: {', '.join(copies)}"] if copies else []


def _require_one_source(parts: Sequence[Sequence[Segment]]) -> None:
    """Raise DataError when some flights know the rotors' speeds and others what was commanded."""
    by_source: dict[str, list[str]] = {}
    for segments_of_one in parts:
        first = segments_of_one[0]
        by_source.setdefault(first.rotor_source.replace("_", " "), []).append(Path(first.flight).name)
    if len(by_source) > 1:
        told = "; ".join(f"{source}: {', '.join(names[:3])}" for source, names in by_source.items())
        raise DataError(
            f"the logs know different things of their rotors ({told}). Give logs of one kind, or leave the columns "
            "rotor_speed out of those that have them."
        )


def _missing(flight: Flight) -> list[str]:
    notes = [f"too slow to be used: {', '.join(slow)}" for slow in [slow_ones(flight)] if slow]
    if not fast(flight, "specific_force"):
        notes.append("no accelerometer in the log: a force cannot be told from a fault of the pose")
    if not fast(flight, "rate"):
        notes.append("no gyro in the log: torques show only through the attitude, and gyro and clock stay unchecked")
    if not fast(flight, "attitude") or not (fast(flight, "velocity") or fast(flight, "position")):
        notes.append("no pose in the log: gyro and accelerometer alone say nothing of what depends on speed or place")
    return notes


def _held_out(names: Sequence[str], pattern: str | None) -> set[int]:
    if pattern is None:
        count = max(1, round(HELD_OUT_SHARE * len(names)))
        return set(range(len(names) - count, len(names)))
    found = {i for i, name in enumerate(names) if fnmatchcase(name, pattern)}
    if not found or len(found) == len(names):
        which = "none" if not found else "all"
        raise RequestError(
            f"--hold-out {pattern!r} matches {which} of {', '.join(names[:6])}. Wanted a pattern that matches some."
        )
    return found


def _split_in_time(parts: Sequence[Segment]) -> tuple[list[list[Segment]], list[Segment]]:
    """One flight's segments but the last fifth of its rows, and that fifth."""
    total = sum(len(s) for s in parts)
    limit = round((1 - HELD_OUT_SHARE) * total)
    fitted, judged, passed = [], [], 0
    for s in parts:
        cut = min(max(limit - passed, 0), len(s))
        least = 3 * s.rate
        if cut >= least:
            fitted.append(s.between(0, cut))
        if len(s) - cut >= least:
            judged.append(s.between(cut, len(s)))
        passed += len(s)
    if not fitted or not judged:
        raise DataError(f"{total / parts[0].rate:.0f} s of flight are too few to hold a part out. Fly at least 20 s.")
    return [[s] for s in fitted], judged


def _halved(groups: list[list[Segment]]) -> list[list[Segment]] | None:
    """The same with the longest group cut in two, None when all are too short for it."""
    longest = max(range(len(groups)), key=lambda i: max(len(s) for s in groups[i]))
    group = groups[longest]
    if len(group) > 1:
        half = len(group) // 2
        return [*groups[:longest], group[:half], group[half:], *groups[longest + 1 :]]
    segment = group[0]
    if segment.duration < 2 * PART:
        return None
    middle = len(segment) // 2
    halves = [[segment.between(0, middle)], [segment.between(middle, len(segment))]]
    return [*groups[:longest], *halves, *groups[longest + 1 :]]
