"""Several files of one flight, each with its own streams and rate, on the clock that all of them were stamped by."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from dynamics.errors import DataError, RequestError
from flights import pose_source
from flights.events import Event
from flights.hypotheses import explain, in_words
from flights.log import Log, Provenance, Stream, spanning_streams
from flights.reading import read_log

_MIN_SHARED = 0.5  # of the shorter file's duration that two files of one flight have in common
OPTION = "--one-flight"  # of the commands
_POSE = ("position", "velocity", "attitude")


def read_one_flight(paths: Sequence[str | Path], *, mapping: str | Path | None = None, pose: str | None = None) -> Log:
    """The streams of all files of a flight, as one log.

    mapping, pose: as of `read_log`.

    Raises RequestError and DataError as `read_log` does, DataError for files that are not on one clock, or that do not
    fit each other.
    """
    if not paths:
        raise RequestError("no log was given. Give the files of one flight.")
    logs = [read_log(path, mapping=mapping) for path in paths]
    joined = logs[0] if len(logs) == 1 else join(logs)
    return replace(joined, metadata=pose_source.with_source(joined.metadata, pose))


def join(logs: Sequence[Log]) -> Log:
    """One log of the files of a flight. Raises DataError where they are not on one clock, or do not fit each other."""
    for log in logs[1:]:
        _require_one_clock(logs[0], log)
    streams = [
        Stream(stream.name, stream.time + (log.start - logs[0].start), stream.values, stream.source)
        for log in logs
        for stream in log.streams
    ]
    noted = {note for log in logs for note in log.provenance.notes}
    further = [hypothesis for hypothesis in explain(streams) if str(hypothesis) not in noted]
    if further:
        raise DataError(f"{_path(logs)}, as files of one flight: {in_words(further)}")
    start = min(float(stream.time[0]) for stream in spanning_streams(streams))
    events = [
        Event(round(event.time + log.start - logs[0].start - start, 6), event.kind, event.text)
        for log in logs
        for event in log.events
    ]
    return Log(
        tuple(Stream(one.name, one.time - start, one.values, one.source) for one in streams),
        _provenance(logs),
        logs[0].start + start,
        _metadata(logs),
        {name: value for log in reversed(logs) for name, value in log.parameters.items()},
        tuple(sorted(events, key=lambda event: event.time)),
    )


def _span(log: Log) -> tuple[float, float]:
    """First and last stamp on the file's own clock, s."""
    streams = spanning_streams(log.streams)
    first, last = min(stream.time[0] for stream in streams), max(stream.time[-1] for stream in streams)
    return log.start + float(first), log.start + float(last)


def _require_one_clock(first: Log, other: Log) -> None:
    """Raise DataError where two files were not stamped at the same times."""
    (start, end), (other_start, other_end) = _span(first), _span(other)
    shared = min(end, other_end) - max(start, other_start)
    if shared < _MIN_SHARED * min(end - start, other_end - other_start):
        raise DataError(
            f"{first.provenance.path} runs from {start:.3f} to {end:.3f} s of its clock and {other.provenance.path} "
            f"from {other_start:.3f} to {other_end:.3f} s: they are not of one flight, or not on one clock. Give files "
            "with stamps of the same clock."
        )


def _path(logs: Sequence[Log]) -> str:
    """The first file's path, and the names of the others."""
    return " + ".join([logs[0].provenance.path, *(Path(log.provenance.path).name for log in logs[1:])])


def _provenance(logs: Sequence[Log]) -> Provenance:
    digest = hashlib.sha256("".join(log.provenance.sha256 for log in logs).encode()).hexdigest()
    notes = [
        f"{Path(log.provenance.path).name}: {note}"
        for log in logs
        for note in log.provenance.notes
        if OPTION not in note  # advice that has been followed
    ]
    repairs = [
        replace(repair, detail=f"{Path(log.provenance.path).name}: {repair.detail}")
        for log in logs
        for repair in log.provenance.repairs
    ]
    return Provenance(
        _path(logs),
        digest,
        " + ".join(dict.fromkeys(log.provenance.format for log in logs)),
        " + ".join(dict.fromkeys(log.provenance.reader for log in logs)),
        (f"{len(logs)} files joined as one flight, each on its own stamps", *notes),
        tuple(repairs),
        tuple(unused for log in logs for unused in log.provenance.unused),
        tuple(f"{Path(log.provenance.path).name}: {text}" for log in logs for text in log.provenance.inferences),
    )


def _metadata(logs: Sequence[Log]) -> Mapping[str, str]:
    """Metadata of any file, the first one's where several do; the pose is an estimator's where that of any file is."""
    metadata = {key: value for log in reversed(logs) for key, value in log.metadata.items()}
    sources = [pose_source.source_of(log.metadata) for log in logs if any(log.stream(name) for name in _POSE)]
    one = "estimator" if "estimator" in sources else sources[0] if len(set(sources)) == 1 else "unknown"
    return {**metadata, pose_source.KEY: one}
