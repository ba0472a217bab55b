"""Putting a reading together: every reader hands its raw columns to one `Assembly`, which mends or refuses them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError
from flights.log import Reading, Repair, Stream
from flights.quantities import QUANTITIES
from flights.source import MAX_STEP_BACK

MAX_DISORDER = 0.05  # share of rows whose stamp may go back before the file counts as shuffled
STRAY_BY = 1.0  # s that a single stamp may lie away from those around it,
STRAY_END = 3600.0  # s, and at the ends, where a late first or last word is nothing unusual
MAX_STRAY = 0.02  # share of rows beyond which stamps are no damage any more
_MIN_TO_JUDGE = 10
MAX_VALUE = 1e12  # nothing that flies has a value beyond it
LENGTH_TOLERANCE = 0.05  # of an attitude quaternion


class Assembly:
    """Collects streams with what had to be noted or mended about them.

    Times are seconds of the file's clock until `finish` subtracts their start; give integers through `seconds`, so
    that nothing is lost on clocks that count from 1970.
    """

    def __init__(self) -> None:
        self.metadata: dict[str, str] = {}
        self.parameters: dict[str, float] = {}
        self._streams: list[Stream] = []
        self._spares: list[Stream] = []
        self._notes: list[str] = []
        self._repairs: list[Repair] = []
        self._epoch: int | None = None

    def note(self, text: str) -> None:
        """Something a user should know, told once."""
        if text not in self._notes:
            self._notes.append(text)

    def repair(self, name: str, detail: str) -> None:
        """Something that was changed, told once."""
        repair = Repair(name, detail)
        if repair not in self._repairs:
            self._repairs.append(repair)

    def seconds(self, ticks: ArrayLike, per_second: int) -> Floats:
        """Integer stamps as seconds since the first stamp ever given here, exact to the stamp's own resolution."""
        stamps = np.asarray(ticks).astype(np.int64)
        if self._epoch is None and len(stamps):
            self._epoch = int(stamps[0]) * (1_000_000_000 // per_second)
        epoch = (self._epoch or 0) // (1_000_000_000 // per_second)
        return np.asarray((stamps - epoch) / per_second, dtype=float)

    def add(self, name: str, time: ArrayLike, values: ArrayLike, source: str, *, spare: bool = False) -> None:
        """Add a stream. time: (n,) s. values: (n,) or (n, k), in our units and frames.

        Of two streams for one quantity the first is the one to use; a spare one comes behind all others.

        Raises DataError when the time stamps cannot be those of one recording.
        """
        stamps = np.asarray(time, dtype=float)
        table = np.asarray(values, dtype=float).reshape(len(stamps), -1)
        if not len(stamps):
            return
        parts = QUANTITIES[name].parts
        if parts is not None and table.shape[1] != max(1, len(parts)):
            raise ValueError(f"{name} has {max(1, len(parts))} columns, not {table.shape[1]}")
        stamps, table = self._in_order(stamps, table, f"{name} ({source})")
        table = self._finite(table, f"{name} ({source})")
        if QUANTITIES[name].parts == ("w", "x", "y", "z"):
            table = self._unit_length(table, f"{name} ({source})")
        if not len(stamps) or np.isnan(table).all():
            self.note(f"{name} ({source}) holds no value and is left out")
            return
        (self._spares if spare else self._streams).append(Stream(name, stamps, table, source))

    def _in_order(self, time: Floats, values: Floats, what: str) -> tuple[Floats, Floats]:
        """Rows with finite, strictly increasing stamps."""
        known = np.isfinite(time)
        if not known.all():
            self.repair("missing_stamps", f"{what}: {np.count_nonzero(~known)} rows without a time stamp dropped")
            time, values = time[known], values[known]
        stray = _stray(time)
        if stray.any():
            self.repair("stray_stamps", f"{what}: {np.count_nonzero(stray)} rows with a damaged time stamp dropped")
            time, values = time[~stray], values[~stray]
        steps = np.diff(time)
        back = steps < 0
        if back.any():
            furthest = float(-steps.min())
            share = np.count_nonzero(back) / len(steps)
            if share > MAX_DISORDER or furthest > MAX_STEP_BACK:
                row = int(np.argmax(back)) + 2
                raise DataError(
                    f"{what}: the time stamps go back in {np.count_nonzero(back)} of {len(time)} rows, by up to "
                    f"{furthest:.3g} s, first at row {row}. Wanted one recording in the order of its time; split the "
                    "file where its clock was set, or sort it."
                )
            self.repair(
                "reversed_stamps", f"{what}: {np.count_nonzero(back)} rows put in order, by up to {furthest:.3g} s"
            )
            order = np.argsort(time, kind="stable")
            time, values = time[order], values[order]
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
        """The same values with NaN for what cannot be a measurement."""
        with np.errstate(invalid="ignore"):
            absurd = np.abs(values) > MAX_VALUE
        if not absurd.any():
            return values
        count = int(np.count_nonzero(absurd.any(axis=1)))
        self.repair("absurd_values", f"{what}: {count} rows with infinite or impossible values masked")
        return np.where(absurd, np.nan, values)

    def _unit_length(self, values: Floats, what: str) -> Floats:
        """Attitudes of unit length and continuous sign, unless they have both already; NaN where they are none."""
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
        known = np.flatnonzero(np.isfinite(length) & ~wrong)
        fixed = np.full_like(values, np.nan)
        good = values[known]
        if np.max(np.abs(length[known] - 1), initial=0) > 1e-3:  # what is rounded is left as it was written
            good = quaternion.normalise(good)
        fixed[known] = quaternion.continuous(good) if len(known) else good
        return fixed

    def finish(self, *, keep_time: bool = False) -> Reading:
        """The reading, its time starting at 0 with the first sample of any stream unless it shall be kept as it is."""
        found = [*self._streams, *self._spares]
        start = 0.0 if keep_time else min((float(stream.time[0]) for stream in found), default=0.0)
        streams = tuple(
            Stream(stream.name, _shifted(stream.time, start), stream.values, stream.source) for stream in found
        )
        return Reading(
            streams,
            start + (self._epoch or 0) * 1e-9,
            self.metadata,
            self.parameters,
            tuple(self._notes),
            tuple(self._repairs),
        )


def _stray(time: Floats) -> NDArray[np.bool_]:
    """Single rows whose stamp lies far from those around them, as a damaged byte makes it. time: (n,) s."""
    stray = np.zeros(len(time), dtype=bool)
    if len(time) < _MIN_TO_JUDGE:
        return stray
    around = np.stack([np.roll(time, shift) for shift in (-2, -1, 0, 1, 2)])
    off = np.abs(time - np.median(around, axis=0))
    period = float(np.median(np.abs(np.diff(time))))
    stray[2:-2] = off[2:-2] > STRAY_BY + 20 * period  # in a clock that runs forwards a row is its own median
    for end, inner in ((slice(0, 2), time[2:5]), (slice(-2, None), time[-5:-2])):
        stray[end] = np.abs(time[end] - np.median(inner)) > STRAY_END + 1000 * period
    return stray if stray.mean() < MAX_STRAY else np.zeros(len(time), dtype=bool)


def _shifted(time: NDArray[np.float64], start: float) -> Floats:
    return time - start if start else time
