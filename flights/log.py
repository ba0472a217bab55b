"""One file's flight data before alignment: streams, each on its own clock and rate.

Readers turn files into `LogContent`; `flights.reading.read_log` adds the provenance and makes it a `Log`. Every change
that a reader makes to the file's content is a named `Repair`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from dynamics.arrays import Floats
from flights.events import Event
from flights.quantities import PRIMARY, QUANTITIES, Quantity

_ELEMENT = re.compile(r"([a-z]+)\[(\d+)\]")
# names of repairs that leave something out
DAMAGE = (
    "torn_gzip", "torn_rows", "torn_record", "torn_end", "damaged_messages", "damaged_frames", "skipped_bytes",
    "checksum_failed", "stream_cut", "stream_left_out",
)  # fmt: skip


@dataclass(frozen=True)
class Repair:
    """One change that a reader made to the file's content.

    name: for programs.
    detail: for people.
    """

    name: str
    detail: str

    def __str__(self) -> str:
        return f"{self.name}: {self.detail}"


@dataclass(frozen=True)
class UnusedStream:
    """Numbers of the file that may be a quantity and are not used as one.

    source: topic with its instance, message, or table.
    fields: of the source, in its order; empty where its numbers cannot be read.
    quantity: which they may be, by its name in `flights.quantities`.
    low, high: the range over which they move, in the file's unit; where they stand, if they stand still.
    moves: whether any of them moves.
    count: of samples.
    reason: why they are not used.
    """

    source: str
    fields: tuple[str, ...]
    quantity: str
    low: float
    high: float
    moves: bool
    count: int
    reason: str

    @property
    def is_candidate(self) -> bool:
        """Whether it may be its quantity: it moves, or cannot be read."""
        return self.moves or not self.fields

    def __str__(self) -> str:
        if not self.fields:
            return f"{self.source}: {self.count} samples; not used: {self.reason}"
        does = "move" if self.moves else "stand still"
        if len(self.fields) == 1:
            does += "s" if self.moves else ""
            does = does.replace("stand ", "stands ")
        span = f"at {self.low:.6g}"
        if self.high > self.low:
            ends = f"{self.low:.6g} and {self.high:.6g}"
            span = f"between {ends}" if self.moves else f"at values between {ends}"
        return f"{self.source}: {_listed(self.fields)} {does} {span}; not used: {self.reason}"


def _listed(fields: Sequence[str]) -> str:
    """Names of fields as few words: "outputs 0 to 3" for output[0] to output[3]."""
    if len(fields) == 1:
        return fields[0]
    parts = [_ELEMENT.fullmatch(name) for name in fields]
    if all(parts) and len({part[1] for part in parts if part}) == 1:
        numbers = [int(part[2]) for part in parts if part]
        name = f"{parts[0][1]}s" if parts[0] else ""
        if numbers == list(range(numbers[0], numbers[-1] + 1)):
            return f"{name} {numbers[0]} to {numbers[-1]}"
        return f"{name} {', '.join(map(str, numbers))}"
    return f"{fields[0]} and {fields[1]}" if len(fields) == 2 else f"{fields[0]} to {fields[-1]}"


@dataclass(frozen=True, eq=False)
class Stream:
    """One quantity from one source.

    name: of the quantity.
    time: (n,) s since the log's start, strictly increasing.
    values: (n, k) SI in our frames; NaN where the source had no value.
    source: the topic or the columns it was read from.
    """

    name: str
    time: Floats
    values: Floats
    source: str

    @property
    def quantity(self) -> Quantity:
        """Unit, frame and kind."""
        return QUANTITIES[self.name]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of `values`."""
        return self.quantity.columns(self.values.shape[1])

    @property
    def unit(self) -> str:
        """Unit of every column."""
        return self.quantity.unit

    @property
    def frame(self) -> str:
        """Frame of the components, empty where there is none."""
        return self.quantity.frame

    @cached_property
    def period(self) -> float:
        """Median time between two samples, s; infinite for a single one."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else float("inf")

    @property
    def rate(self) -> float:
        """Samples a second while it was logged, 0 for a single one."""
        return 1.0 / self.period


@dataclass(frozen=True)
class Origin:
    """Where a quantity of a flight came from.

    source: topic or columns.
    rate: at which it was logged, Hz.
    samples: their number, as logged.
    """

    source: str
    rate: float
    samples: int


@dataclass(frozen=True, eq=False)
class LogContent:
    """A file's content.

    streams: several may be of the same quantity; the first is the one to use.
    start: the file's own clock at time 0, s.
    parameters: of the vehicle, by their own names.
    notes: assumptions, and data that the file lacks or that were left out.
    repairs: changes to the file's content.
    events: modes and messages, in the order of time.
    unused: numbers that may be a flight's quantity and are not used as one.
    inferences: notes on ranges, units and orders as they were understood, and on what that rests.
    """

    streams: tuple[Stream, ...]
    start: float = 0.0
    metadata: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    repairs: tuple[Repair, ...] = ()
    events: tuple[Event, ...] = ()
    unused: tuple[UnusedStream, ...] = ()
    inferences: tuple[str, ...] = ()


@dataclass(frozen=True)
class Provenance:
    """Where a log came from.

    sha256: of the file on disk, compressed or not.
    format, reader: name for people, and module.
    unused: numbers of the file that may be a flight's quantity and are not used as one.
    inferences: those of the notes on ranges, units and orders as they were understood, and on what that rests.
    """

    path: str
    sha256: str
    format: str
    reader: str
    notes: tuple[str, ...] = ()
    repairs: tuple[Repair, ...] = ()
    unused: tuple[UnusedStream, ...] = ()
    inferences: tuple[str, ...] = ()

    def candidates(self, names: Collection[str]) -> tuple[UnusedStream, ...]:
        """Unused numbers that may be one of some quantities: what of them is in the file after all."""
        return tuple(unused for unused in self.unused if unused.is_candidate and unused.quantity in names)

    @property
    def damage(self) -> tuple[str, ...]:
        """Losses of the file: cut off, torn or damaged."""
        return tuple(repair.detail for repair in self.repairs if repair.name in DAMAGE)


@dataclass(frozen=True, eq=False)
class Log:
    """All streams of one file with their provenance."""

    streams: tuple[Stream, ...]
    provenance: Provenance
    start: float = 0.0
    metadata: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    events: tuple[Event, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Its quantities, each once, in the order of the flight CSV."""
        present = {stream.name for stream in self.streams}
        return tuple(name for name in QUANTITIES if name in present)

    def stream(self, name: str) -> Stream | None:
        """The stream to use for a quantity, None when there is none."""
        return next((stream for stream in self.streams if stream.name == name), None)

    def alternatives(self, name: str) -> tuple[Stream, ...]:
        """Every stream of a quantity, the one to use first."""
        return tuple(stream for stream in self.streams if stream.name == name)

    @property
    def duration(self) -> float:
        """Seconds from the first sample of motion or rotors to the last, of any stream where there are none."""
        if not self.streams:
            return 0.0
        spanning = spanning_streams(self.streams)
        return float(max(stream.time[-1] for stream in spanning) - min(stream.time[0] for stream in spanning))


def spanning_streams(streams: Sequence[Stream]) -> list[Stream]:
    """Streams whose time is the flight's: of motion and rotors, or all where there are none."""
    return [stream for stream in streams if stream.name in PRIMARY] or list(streams)
