"""A recording's topics as arrays on one clock that begins with the first tick."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.errors import DataError
from flights.followed import TRACKED, FollowedFlight, read_followed
from runtime.record.recording import FlightRecording, read_recording
from runtime.record.records import (
    TOPICS,
    BatteryRecord,
    EstimateRecord,
    EventRecord,
    PhaseRecord,
    ReferenceRecord,
    SetpointRecord,
    StateRecord,
    TickRecord,
)

Table = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class RecordedFlight:
    """A recorded flight.

    start: time of the first tick, s of the daemon's clock; the times below count from it, those in tables do not.
    time: (n,) s, of the estimates that have a reference.
    position, reference: (n, 3) m, world.
    tick_time: (m,) s.
    ticks, setpoints, battery: tables of their topics.
    followed: what the model followed; None where it did not.
    phases: start and name.
    """

    path: Path
    recording: FlightRecording
    start: float
    time: Floats
    position: Floats
    reference: Floats
    tick_time: Floats
    ticks: Table
    setpoints: Table
    battery: Table
    followed: FollowedFlight | None
    phases: tuple[tuple[float, str], ...]

    @property
    def distance(self) -> Floats:
        """(n,) m from the reference."""
        return np.asarray(np.linalg.norm(self.position - self.reference, axis=1))

    @property
    def tracked(self) -> NDArray[np.bool_]:
        """(n,) whether the reference was being tracked."""
        inside = np.zeros(len(self.time), dtype=bool)
        ends = [start for start, _ in self.phases[1:]] + [np.inf]
        for (start, phase), end in zip(self.phases, ends, strict=True):
            if phase == TRACKED:
                inside |= (self.time >= start) & (self.time < end)
        return inside

    def rows(self, kind: type[EventRecord | StateRecord]) -> list[dict[str, Any]]:
        """A topic's rows, with times from the start."""
        return [{**row, "time": row["time"] - self.start} for row in self.recording.messages.get(TOPICS[kind], [])]


def read_flight_record(path: Path) -> RecordedFlight:
    """Read a recording of `alula fly`. Raises RequestError and DataError for what it cannot be."""
    recording = read_recording(path)
    ticks = recording.table(TOPICS[TickRecord])
    if not ticks:
        raise DataError(f"{path}: no tick was recorded. Was the daemon ended before it heard a vehicle?")
    start = float(ticks["time"][0])
    estimates, references = (recording.table(TOPICS[kind]) for kind in (EstimateRecord, ReferenceRecord))
    time, first, second = (
        np.intersect1d(estimates["time"], references["time"], return_indices=True)
        if estimates and references
        else (np.zeros(0), np.zeros(0, dtype=int), np.zeros(0, dtype=int))
    )
    empty = np.zeros((0, 3))
    phases = tuple(
        (float(row["time"]) - start, str(row["phase"])) for row in recording.messages.get(TOPICS[PhaseRecord], [])
    )
    return RecordedFlight(
        path,
        recording,
        start,
        time - start,
        estimates["position_world"][first] if len(time) else empty,
        references["position_world"][second] if len(time) else empty,
        ticks["time"] - start,
        ticks,
        recording.table(TOPICS[SetpointRecord]),
        recording.table(TOPICS[BatteryRecord]),
        read_followed(path),
        phases,
    )
