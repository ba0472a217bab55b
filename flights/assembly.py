"""Checking and repair of what a reader extracts: every reader hands its raw columns to one `Assembly`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError
from flights.events import MAX_EVENTS, Event, EventKind, cleaned
from flights.log import LogContent, Repair, Stream, UnusedStream, spanning_streams
from flights.movement import moves
from flights.quantities import PRIMARY, QUANTITIES, ROTORS
from flights.rival_streams import settled
from flights.source import MAX_STEP_BACK

MAX_DISORDER = 0.05  # share of rows whose stamp may go back before the file counts as shuffled
STRAY_PERIODS = 3  # that a single stamp lies away from those around it, where that is more than MAX_STEP_BACK; or
STRAY_END = 3600.0  # s, and at the ends, where a late first or last sample is usual
MAX_STRAY = 0.02  # share of stray rows above which the stamps are not damaged but another clock's
_MIN_TO_JUDGE = 10
MAX_VALUE = 1e12  # nothing that flies has a value beyond it
LENGTH_TOLERANCE = 0.05  # of an attitude quaternion
EMPTY = "holds no value and is left out"  # ends the note on such a stream


class Assembly:
    """Collects a file's streams, and the notes and repairs about them.

    Times are seconds of the file's clock until `finish` subtracts their start. Integer stamps go through `seconds`,
    which loses no resolution on clocks that count from 1970.
    """

    def __init__(self) -> None:
        self.metadata: dict[str, str] = {}
        self.parameters: dict[str, float] = {}
        self.labels: dict[str, str] = {}  # the name to show for a source, where the file has another one
        self.origin = 0.0  # s of the file's clock at the time 0 of what is added
        self._streams: list[Stream] = []
        self._spares: list[Stream] = []
        self._faults: dict[str, tuple[str, DataError]] = {}  # of primary quantities, by source
        self._notes: list[str] = []
        self._events: list[Event] = []
        self._repairs: list[Repair] = []
        self._unused: list[UnusedStream] = []
        self._inferences: list[str] = []
        self._epoch: int | None = None

    def note(self, text: str) -> None:
        """Add a note for the user, each once."""
        if text not in self._notes:
            self._notes.append(text)

    def infer(self, text: str) -> None:
        """Add a note on a range, unit or order as it was understood, and on what that rests; each once."""
        self.note(text)
        if text not in self._inferences:
            self._inferences.append(text)

    def event(self, time: float, kind: EventKind, text: str) -> None:
        """Add a change of mode or a message. time: s of the file's clock."""
        if math.isfinite(time) and len(self._events) < MAX_EVENTS and (shown := cleaned(text)):
            self._events.append(Event(time, kind, shown))

    def repair(self, name: str, detail: str) -> None:
        """Add a change to the file's content, each once."""
        repair = Repair(name, detail)
        if repair not in self._repairs:
            self._repairs.append(repair)

    def leave_out(
        self, quantity: str, source: str, fields: Sequence[str], values: ArrayLike, reason: str, *, count: int = 0
    ) -> None:
        """Keep what is said of numbers that may be a quantity and are not used as one.

        values: (n, k), a column a field, in the file's unit.
        count: of samples, where `values` are fewer.
        """
        table = np.asarray(values, dtype=float).reshape(-1, len(fields))
        finite = np.isfinite(table).any(axis=0)
        moving = np.array([moves(column) for column in table.T], dtype=bool)
        shown = moving if moving.any() else finite
        if not shown.any():
            return
        part = table[:, shown]
        unused = UnusedStream(
            source,
            tuple(name for name, is_shown in zip(fields, shown.tolist(), strict=True) if is_shown),
            quantity,
            float(np.nanmin(part)),
            float(np.nanmax(part)),
            bool(moving.any()),
            count or len(table),
            reason,
        )
        if unused not in self._unused:
            self._unused.append(unused)

    def leave_out_undecoded(self, quantity: str, source: str, count: int, reason: str) -> None:
        """Keep a source whose numbers cannot be read and may be a quantity. count: of its samples."""
        unused = UnusedStream(source, (), quantity, 0.0, 0.0, False, count, reason)
        if unused not in self._unused:
            self._unused.append(unused)

    def stream(self, name: str) -> Stream | None:
        """The stream that was added first for a quantity."""
        return next((stream for stream in (*self._streams, *self._spares) if stream.name == name), None)

    def seconds(self, ticks: ArrayLike, per_second: int) -> Floats:
        """Integer stamps as seconds since the first stamp of the first call, exact to the stamp's own resolution."""
        stamps = np.asarray(ticks).astype(np.int64)
        if self._epoch is None and len(stamps):
            self._epoch = int(stamps[0]) * (1_000_000_000 // per_second)
        epoch = (self._epoch or 0) // (1_000_000_000 // per_second)
        return np.asarray((stamps - epoch) / per_second, dtype=float)

    def add(self, name: str, time: ArrayLike, values: ArrayLike, source: str, *, spare: bool = False) -> None:
        """Add a stream; of several for one quantity the first is used.

        time: (n,) s.
        values: (n,) or (n, k), in our units and frames.
        spare: used only where no other source has the quantity.

        A source whose stamps or values cannot be those of one recording is left out; `finish` raises its error where
        the quantity is primary and no other source has it. A secondary one is cut where its clock was set.
        """
        stamps = np.asarray(time, dtype=float)
        if not len(stamps):
            return
        source = self.labels.get(source, source)
        what = f"{name} ({source})"
        try:
            stamps, table = self._checked(name, stamps, np.asarray(values, dtype=float), what)
        except DataError as error:
            if name in PRIMARY:
                self._faults.setdefault(what, (name, error))
            else:
                self.repair("stream_left_out", f"{error} It is left out.")
            table = np.asarray(values, dtype=float).reshape(len(stamps), -1)
            width = range(table.shape[1])
            self.leave_out(name, source, [f"{name}[{column}]" for column in width], table, "its rows are no recording")
            return
        if not len(stamps) or np.isnan(table).all():
            self.note(f"{what} {EMPTY}")
            return
        (self._spares if spare else self._streams).append(Stream(name, stamps, table, source))

    def _checked(self, name: str, time: Floats, values: Floats, what: str) -> tuple[Floats, Floats]:
        """Stamps (n,) and values (n, k) of a stream, repaired. Raises DataError where they are none of one recording.

        values: (m,) or (m, k).
        """
        table, parts = values.reshape(len(time), -1), QUANTITIES[name].parts
        if parts is not None and table.shape[1] != max(1, len(parts)):
            raise DataError(f"{what}: it has {table.shape[1]} columns. Wanted {max(1, len(parts))}.")
        if name not in PRIMARY:
            time, table = self._cut(time, table, what)
        time, table = self._in_order(time, table, what)
        table = self._finite(table, what)
        return time, self._unit_length(table, what) if parts == ("w", "x", "y", "z") else table

    def _cut(self, time: Floats, values: Floats, what: str) -> tuple[Floats, Floats]:
        """The longest part of a stream between places where its clock goes back too far to put its rows in order."""
        edges = [0, *(np.flatnonzero(np.diff(time) < -MAX_STEP_BACK) + 1).tolist(), len(time)]
        if len(edges) == 2 or _stray(time).any():
            return time, values
        start, stop = max(pairwise(edges), key=lambda part: part[1] - part[0])
        self.repair(
            "stream_cut",
            f"{what}: the time stamps go back by up to {float(-np.diff(time).min()):.3g} s; of {len(time)} rows those "
            f"from {start + 1} to {stop} are used, which are in order",
        )
        return time[start:stop], values[start:stop]

    def _in_order(self, time: Floats, values: Floats, what: str) -> tuple[Floats, Floats]:
        """Rows with finite, strictly increasing stamps."""
        stamped = np.isfinite(time)
        if not stamped.all():
            self.repair("missing_stamps", f"{what}: {np.count_nonzero(~stamped)} rows without a time stamp dropped")
            time, values = time[stamped], values[stamped]
        stray = _stray(time)
        if stray.any():
            self.repair("stray_stamps", f"{what}: {np.count_nonzero(stray)} rows with a damaged time stamp dropped")
            time, values = time[~stray], values[~stray]
        steps = np.diff(time)
        back = steps < 0
        if back.any():
            largest = float(-steps.min())
            share = np.count_nonzero(back) / len(steps)
            if share > MAX_DISORDER or largest > MAX_STEP_BACK:
                row = int(np.argmax(back)) + 2
                raise DataError(
                    f"{what}: the time stamps go back in {np.count_nonzero(back)} of {len(time)} rows, by up to "
                    f"{largest:.3g} s, first at row {row}. Wanted one recording in the order of its time; split the "
                    "file where its clock was set, or sort it."
                )
            self.repair(
                "reversed_stamps", f"{what}: {np.count_nonzero(back)} rows put in order, by up to {largest:.3g} s"
            )
            order = np.argsort(time, kind="stable")
            time, values = time[order], values[order]
        repeated = np.concatenate([[False], np.diff(time) == 0])
        if repeated.any() and (empty := np.isnan(values).all(axis=1)).any():  # another sensor's row of the same moment
            alone = ~(empty & (repeated | np.concatenate([repeated[1:], [False]])))
            time, values = time[alone], values[alone]
            repeated = np.concatenate([[False], np.diff(time) == 0])
        if repeated.any():
            if repeated.mean() > 0.5:
                raise DataError(
                    f"{what}: {np.count_nonzero(repeated)} of {len(time)} rows repeat the time stamp before them. "
                    "Wanted stamps that resolve the samples; check the time column and its unit."
                )
            self.repair("repeated_stamps", f"{what}: {np.count_nonzero(repeated)} rows with the stamp before dropped")
            time, values = time[~repeated], values[~repeated]
        return time, values

    def _finite(self, values: Floats, what: str) -> Floats:
        """The values with NaN in place of impossible ones."""
        with np.errstate(invalid="ignore"):
            absurd = np.abs(values) > MAX_VALUE
        if not absurd.any():
            return values
        count = int(np.count_nonzero(absurd.any(axis=1)))
        self.repair("absurd_values", f"{what}: {count} rows with infinite or impossible values masked")
        return np.where(absurd, np.nan, values)

    def _unit_length(self, values: Floats, what: str) -> Floats:
        """Attitudes of unit length and continuous sign; NaN where the values are no quaternion."""
        length = np.linalg.norm(values, axis=1)
        empty = length < 1e-6  # how senders write that there is none
        values = np.where(empty[:, None], np.nan, values)
        length = np.where(empty, np.nan, length)
        wrong = np.isfinite(length) & (np.abs(length - 1) > LENGTH_TOLERANCE)
        if wrong.mean() > 0.5:
            raise DataError(
                f"{what}: the quaternions' length is {np.nanmedian(length):.3g}, wanted 1. Check that these "
                "columns are an attitude, and its scale."
            )
        if wrong.any():
            self.repair("no_attitude", f"{what}: {np.count_nonzero(wrong)} rows that are no unit quaternion masked")
        valid = np.flatnonzero(np.isfinite(length) & ~wrong)
        fixed = np.full_like(values, np.nan)
        good = values[valid]
        if np.max(np.abs(length[valid] - 1), initial=0) > 1e-3:  # rounded values stay as they were written
            good = quaternion.normalise(good)
        fixed[valid] = quaternion.continuous(good) if len(valid) else good
        return fixed

    def settle_rivals(self) -> None:
        """Use of several streams for a quantity one that moves, and list the others as unused."""
        streams, lost = settled([*self._streams, *self._spares], self._unused)
        self._streams, self._spares = streams, []
        for stream, reason in lost:
            self.leave_out(stream.name, stream.source, stream.columns, stream.values, reason)

    def finish(self, *, keep_time: bool = False) -> LogContent:
        """The content, its time starting at 0 with the first sample of motion or rotors.

        keep_time: leave the time as it is.

        Raises DataError where no source of a primary quantity can be used, and one is there.
        """
        streams = [*self._streams, *self._spares]
        present = {stream.name for stream in streams}
        for name, error in self._faults.values():
            if present.isdisjoint(ROTORS if name in ROTORS else (name,)):
                raise error
            self.repair("stream_left_out", f"{error} It is left out, since another source has that quantity.")
        spanning = spanning_streams(streams)
        start = 0.0 if keep_time else min((float(stream.time[0]) for stream in spanning), default=0.0)
        return LogContent(
            tuple(Stream(one.name, _shifted(one.time, start), one.values, one.source) for one in streams),
            start + self.origin + (self._epoch or 0) * 1e-9,
            self.metadata,
            self.parameters,
            tuple(self._notes),
            tuple(self._repairs),
            tuple(Event(round(e.time - start, 6), e.kind, e.text) for e in sorted(self._events, key=lambda e: e.time)),
            tuple(self._unused),
            tuple(self._inferences),
        )


def _stray(time: Floats) -> NDArray[np.bool_]:
    """(n,) whether a single row's stamp lies far from its neighbours', as after a damaged byte. time: (n,) s."""
    stray = np.zeros(len(time), dtype=bool)
    if len(time) < _MIN_TO_JUDGE:
        return stray
    around = np.stack([np.roll(time, shift) for shift in (-2, -1, 0, 1, 2)])
    off = np.abs(time - np.median(around, axis=0))
    period = float(np.median(np.abs(np.diff(time))))
    stray[2:-2] = off[2:-2] > max(
        MAX_STEP_BACK, STRAY_PERIODS * period
    )  # where the clock runs forwards, a row is its own median
    for end, inner in ((slice(0, 2), time[2:5]), (slice(-2, None), time[-5:-2])):
        stray[end] = np.abs(time[end] - np.median(inner)) > STRAY_END + 1000 * period
    return stray if stray.mean() < MAX_STRAY else np.zeros(len(time), dtype=bool)


def _shifted(time: NDArray[np.float64], start: float) -> Floats:
    return time - start if start else time
