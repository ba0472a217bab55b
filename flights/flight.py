"""A flight: quantities on one clock, with unit and frame of each, and its provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from dynamics.spelling import unknown
from flights import tables
from flights.alignment import align
from flights.log import Log, Origin, Provenance, Stream
from flights.pose_source import PoseSource, source_of
from flights.quantities import (
    MAX_ROTORS,
    MOTION,
    QUANTITIES,
    RESET_COUNTERS,
    Quantity,
    all_parts,
    known_columns,
    quantity_of,
)
from flights.reading import read_log

if TYPE_CHECKING:
    import pandas

MIN_SEGMENT = 0.5  # s
SAME_RATE = 1e-6  # of a rate, within which clocks differ by rounding
MAX_JITTER = 0.5  # of a period, by which a row may be early or late


@dataclass(frozen=True, eq=False)
class Flight:
    """One flight on one uniform clock; unit and frame of every column are those of `flights.quantities`.

    time: (n,) s.
    values: quantity to (n, k), read-only, NaN where there was no sample. A flight is made of columns as well, name to
        (n,), which files have: of all columns of a quantity, or none.
    provenance: the file.
    origins: source and logged rate of each quantity.
    parameters: of the vehicle, as it logged them.
    """

    time: Floats
    values: Mapping[str, Floats]
    provenance: Provenance
    origins: Mapping[str, Origin] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Order the quantities and make everything read-only; refuse columns that are not the flight CSV's."""
        foreign = [name for name, values in self.values.items() if not _is_known(name, np.ndim(values))]
        if foreign:
            raise DataError(f"{', '.join(foreign)} are no columns of a flight{unknown(foreign[0], known_columns())}")
        if any(np.shape(values)[:1] != self.time.shape for values in self.values.values()):
            raise DataError("the columns of a flight must all be as long as its time.")
        _require_uniform(self.time)
        arrays = _by_quantity(self.values)
        wrong = [name for name, values in arrays.items() if not _has_its_width(name, values)]
        if wrong:
            raise DataError(f"{wrong[0]} has the shape {arrays[wrong[0]].shape}, wanted (n, k) with its k columns.")
        frozen = {name: _read_only(arrays[name]) for name in QUANTITIES if name in arrays}
        object.__setattr__(self, "time", _read_only(self.time))
        object.__setattr__(self, "values", MappingProxyType(frozen))

    @classmethod
    def read(cls, path: str | Path, *, mapping: str | Path | None = None, rate: float | None = None) -> Self:
        """The flight of a log of any format; the format is detected by content.

        mapping: column-mapping TOML for a foreign CSV.
        rate: Hz of the common clock, by default that of the log's gyro.

        Raises RequestError for a path or a mapping that is wrong, DataError for a log that cannot be read or holds no
        flight.
        """
        return cls.from_log(read_log(path, mapping=mapping), rate=rate)

    @classmethod
    def from_log(cls, log: Log, *, rate: float | None = None) -> Self:
        """A log's streams as one aligned table. Raises DataError when there is nothing to align."""
        table = align(log, rate=rate)
        return cls(table.time, table.values, log.provenance, table.origins, log.parameters, log.metadata)

    def __len__(self) -> int:
        return len(self.time)

    def __str__(self) -> str:
        """A summary: the file, its length, and each quantity with its unit, frame, logged rate and source."""
        name, rows = Path(self.provenance.path).name, f"{len(self)} rows at {self.rate:.0f} Hz"
        lines = [f"{name} ({self.provenance.format}): {self.duration:.1f} s, {rows}"]
        width = max((len(quantity) for quantity in self.quantities), default=0)
        for quantity in self.quantities:
            kind = QUANTITIES[quantity]
            origin = self.origins.get(quantity)
            logged = "" if origin is None else f"logged at {origin.rate:.0f} Hz, {origin.source}"
            missing = 100 * float(np.mean(~np.isfinite(self[quantity])))
            gaps = f"{missing:.0f} % missing" if missing >= 0.5 else ""
            unit = "" if kind.unit == "1" else kind.unit
            facts = ", ".join(filter(None, [" ".join(filter(None, [unit, kind.frame])), logged, gaps]))
            lines.append(f"  {quantity:<{width}}  {facts}".rstrip())
        return "\n".join(lines)

    @property
    def period(self) -> float:
        """Seconds between two rows, 0 for fewer than two."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0

    @property
    def rate(self) -> float:
        """Rows a second, 0 for fewer than two."""
        return 1.0 / self.period if self.period else 0.0

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return float(self.time[-1] - self.time[0]) if len(self.time) else 0.0

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantities it has, in the order of the flight CSV."""
        return tuple(self.values)

    @cached_property
    def columns(self) -> Mapping[str, Floats]:
        """The columns (n,) by the names that files have for them, in the order of the flight CSV."""
        return MappingProxyType({c: values for name in self.values for c, values in self.columns_of(name).items()})

    def columns_of(self, quantity: str) -> dict[str, Floats]:
        """The columns (n,) of one of its quantities by their names."""
        values = self.values[quantity]
        return dict(zip(QUANTITIES[quantity].columns(values.shape[1]), values.T, strict=True))

    @property
    def pose_source(self) -> PoseSource:
        """Where its pose comes from, as far as the log or the user told."""
        return source_of(self.metadata)

    def has(self, *names: str) -> bool:
        """Whether it has all of these quantities."""
        return set(names) <= self.values.keys()

    def __getitem__(self, name: str) -> Floats:
        """A quantity (n, k), or (n,) of a scalar; or one column (n,) of a quantity.

        Raises DataError when the flight has neither.
        """
        kind = QUANTITIES.get(name) or quantity_of(name)
        if kind is not None and kind.name in self.values:
            values = self.values[kind.name]
            if name == kind.name and kind.parts != ():
                return values
            columns = self.columns_of(kind.name)
            if name in columns:
                return columns[name]
        raise DataError(
            f"{self.provenance.path} has no {name}; it has {', '.join(self.quantities)}. Log it, or give a flight "
            "that has it."
        )

    def unit(self, name: str) -> str:
        """Unit of a column or quantity. Raises RequestError for one that no flight has."""
        return self._quantity(name).unit

    def frame(self, name: str) -> str:
        """Frame of a column or quantity, empty where there is none. Raises RequestError for one that no flight has."""
        return self._quantity(name).frame

    @staticmethod
    def _quantity(name: str) -> Quantity:
        quantity = quantity_of(name) or QUANTITIES.get(name)
        if quantity is None:
            raise RequestError(f"{name!r} is no column of a flight{unknown(name, known_columns())}")
        return quantity

    def rows(self, start: int, stop: int) -> Self:
        """The rows from start to before stop, with their times as they are."""
        values = {name: array[start:stop] for name, array in self.values.items()}
        return type(self)(self.time[start:stop], values, self.provenance, self.origins, self.parameters, self.metadata)

    def has_rate(self, rate: float) -> bool:
        """Whether it is of a single row, or of this rate, Hz, but for the rounding of its clock."""
        return not self.rate or abs(self.rate - rate) < SAME_RATE * rate

    def at_rate(self, rate: float) -> Self:
        """The flight on a clock of another rate, Hz; of a log, `from_log` interpolates once less."""
        streams = tuple(Stream(name, self.time, values, "") for name, values in self.values.items())
        log = Log(streams, self.provenance, metadata=self.metadata, parameters=self.parameters)
        return replace(type(self).from_log(log, rate=rate), origins=self.origins)

    def usable(self) -> NDArray[np.bool_]:
        """(n,) whether the vehicle was armed, as far as that was logged, and no quantity of motion has a gap."""
        good = np.ones(len(self.time), dtype=bool)
        if self.has("armed"):
            good &= self["armed"] != 0.0  # before its first sample nothing is excluded
        for name in MOTION:
            if self.has(name):
                good &= np.isfinite(self[name]).all(axis=1)
        return good

    def segments(self, *, exclude: NDArray[np.bool_] | None = None, shortest: float = MIN_SEGMENT) -> tuple[Self, ...]:
        """The segments without a gap, a disarmed vehicle or an estimator reset inside.

        exclude: (n,) further rows to leave out, as ground contact and crashes.
        shortest: s; shorter ones are dropped.
        """
        good = self.usable()
        if exclude is not None:
            good &= ~exclude
        breaks = np.zeros(len(self.time), dtype=bool)
        for name in RESET_COUNTERS:
            if self.has(name):
                breaks[1:] |= np.diff(_filled(self[name])) != 0
        segment = np.cumsum(breaks | np.concatenate([[True], good[1:] != good[:-1]])) if len(good) else good
        edges = np.flatnonzero(np.diff(segment, prepend=-1, append=-1)) if len(good) else np.empty(0, dtype=int)
        bounds = zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True) if len(edges) else ()
        min_rows = max(2, round(shortest * self.rate))
        return tuple(self.rows(start, stop) for start, stop in bounds if good[start] and stop - start >= min_rows)

    def to_pandas(self) -> pandas.DataFrame:
        """The flight as a data frame, indexed by time in s; `frame.attrs` holds the file, "units" and "frames"."""
        import pandas

        index = pandas.Index(np.array(self.time), name="time")
        frame = pandas.DataFrame({name: np.array(values) for name, values in self.columns.items()}, index=index)
        frame.attrs["path"] = self.provenance.path
        frame.attrs["units"] = {name: self.unit(name) for name in self.columns}
        frame.attrs["frames"] = {name: self.frame(name) for name in self.columns}
        return frame

    def to_csv(self, path: str | Path) -> Path:
        """Write the flight CSV, which is read back bit for bit. Raises RequestError when it cannot be written."""
        return tables.write_csv(self.time, self.columns, Path(path))

    def to_parquet(self, path: str | Path) -> Path:
        """Write a Parquet file with origins and provenance. Raises RequestError when it cannot be written."""
        notes = tables.Notes(self.provenance, dict(self.origins), dict(self.parameters), dict(self.metadata))
        return tables.write_parquet(self.time, self.columns, notes, Path(path))


def _by_quantity(table: Mapping[str, Floats]) -> dict[str, Floats]:
    """Quantity to (n, k) of a table of quantities (n, k) and of columns (n,), whose names `quantity_of` knows."""
    arrays = {name: values for name, values in table.items() if name in QUANTITIES and np.ndim(values) == 2}
    columns: dict[str, dict[str, Floats]] = {}
    for name, values in table.items():
        if name not in arrays and (quantity := quantity_of(name)) is not None:
            columns.setdefault(quantity.name, {})[name] = values
    for name, parts in columns.items():
        arrays[name] = np.stack([parts[part] for part in all_parts(QUANTITIES[name], parts)], axis=1)
    return arrays


def _is_known(name: str, dimensions: int) -> bool:
    """Whether a flight has such a column, or such a quantity where it is an array (n, k)."""
    return quantity_of(name) is not None or (dimensions == 2 and name in QUANTITIES)


def _has_its_width(name: str, values: Floats) -> bool:
    return values.ndim == 2 and len(QUANTITIES[name].columns(values.shape[1])) == values.shape[1] <= MAX_ROTORS


def _require_uniform(time: Floats) -> None:
    """Raise DataError where the clock of rows is not uniform: a gap would be taken for one period."""
    periods = np.diff(time)
    if not len(periods):
        return
    usual = float(np.nanmedian(periods))
    wrong = np.flatnonzero(~(np.abs(periods - usual) <= MAX_JITTER * usual))
    if len(wrong):
        place = int(wrong[0])
        raise DataError(
            f"the rows of a flight must follow each other by one period, here {usual:.4g} s, but {time[place + 1]:.6g} "
            f"follows {time[place]:.6g} s. Put rows of NaN where there is no data, or read a file, which does so."
        )


def _read_only(values: Floats) -> Floats:
    view = np.ascontiguousarray(values, dtype=float).view()
    view.setflags(write=False)
    return view


def _filled(values: Floats) -> Floats:
    """Values with NaN replaced by the value before it, at the start by the first finite one."""
    finite = np.flatnonzero(np.isfinite(values))
    if not len(finite):
        return np.zeros_like(values)
    at = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), finite[0]))
    return values[at]
