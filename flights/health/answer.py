"""The answer about a flight's health: statements with their evidence, events in the order of time, two sentences."""

from __future__ import annotations

from typing import Literal

import msgspec

Certainty = Literal["seen", "likely", "cannot tell"]
Level = Literal["fault", "warning", "note"]


class Evidence(msgspec.Struct, frozen=True):
    """The measurement behind a statement.

    start, end: s since the log's start.
    channel: topic or message, and field.
    value: in `unit`.
    healthy: the limit that healthy logs keep; None where there is none.
    """

    start: float
    end: float
    channel: str
    value: float
    unit: str
    healthy: float | None = None

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        span = f"{self.start:.1f} s" if self.end - self.start < 0.1 else f"{self.start:.1f} to {self.end:.1f} s"
        limit = "" if self.healthy is None else f", healthy logs {self.healthy:.3g}{unit}"
        return f"{span}, {self.channel}: {self.value:.3g}{unit}{limit}"


class Statement(msgspec.Struct, frozen=True):
    """One statement about a flight.

    name: of the kind, for programs.
    level: fault: beyond what a vehicle can fly with for long; warning: beyond healthy logs; note: neither.
    certainty: seen: measured itself; likely: fits the evidence best; cannot tell: the log does not decide.
    rotor: index in the order in which logs are read, None where no single one is meant.
    advice: what to do; empty where nothing is.
    """

    name: str
    level: Level
    certainty: Certainty
    text: str
    evidence: Evidence
    rotor: int | None = None
    advice: str = ""

    @property
    def start(self) -> float:
        """When it begins, s since the log's start."""
        return self.evidence.start


class HealthEvent(msgspec.Struct, frozen=True):
    """One event of the flight. time: s since the log's start. source: topic or message that has it."""

    time: float
    name: str
    text: str
    source: str


class Health(msgspec.Struct, frozen=True):
    """The answer about one log.

    sentences: two: what happened first and what followed, then the state of everything else.
    advice: what to do, the most urgent first.
    first: name of the statement that comes first, empty where nothing departs from healthy logs.
    statements: faults before warnings before notes, each in the order of time.
    events: in the order of time.
    unknown: what the log cannot tell, each with the reason.
    in_air: s between take-offs and landings.
    """

    sentences: tuple[str, str]
    advice: tuple[str, ...]
    first: str
    statements: tuple[Statement, ...]
    events: tuple[HealthEvent, ...]
    unknown: tuple[str, ...]
    in_air: float

    @property
    def defects(self) -> tuple[Statement, ...]:
        """Faults and warnings in the order of time."""
        return tuple(sorted((s for s in self.statements if s.level != "note"), key=lambda s: s.start))
