"""The time of a table: one column of numbers or of text, or two columns, in seconds since its first row."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.errors import DataError
from flights.cells import is_clock
from flights.quantities import quantity_of
from flights.source import TimeSpan

UNITS: Mapping[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
MIN_RATE, MAX_RATE = 1.2, 20_000.0  # Hz; no table with an attitude or an IMU has fewer or more rows a second
MIN_RATE_OF_POSITION = 0.33  # Hz; a table of position alone may be slower
FAST = ("attitude", "rate", "specific_force")
USUAL_RATES = (10.0, 1_200.0)
_DAY = 86_400.0
_SECONDS = re.compile(r"(?:.*[._ ])?(?:tv_)?(?:sec|secs|seconds)$", re.IGNORECASE)
_OTHER_NAME = re.compile(r"(?:time|timestamp|stamp|datetime|zeit)(?:[ _]*[\[(]?\w{1,2}[\])]?)?$", re.IGNORECASE)
_FRACTIONS: Mapping[str, re.Pattern[str]] = {
    "ns": re.compile(r"(?:.*[._ ])?(?:tv_)?(?:nanosec|nanosecs|nsec|nsecs|nanoseconds)$", re.IGNORECASE),
    "us": re.compile(r"(?:.*[._ ])?(?:tv_)?(?:microsec|microsecs|usec|usecs|microseconds)$", re.IGNORECASE),
    "ms": re.compile(r"(?:.*[._ ])?(?:tv_)?(?:millisec|millisecs|msec|msecs|milliseconds)$", re.IGNORECASE),
}


@dataclass(frozen=True)
class TimeColumns:
    """The columns of a table's time.

    unit: of the column, s.
    fraction: column of what a second has beyond the whole ones, empty for none.
    fraction_unit: of that column, s.
    is_text: the column holds times as text, which are read as seconds.
    """

    column: str
    unit: float = 1.0
    fraction: str = ""
    fraction_unit: float = 1e-9
    is_text: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Its columns."""
        return (self.column, self.fraction) if self.fraction else (self.column,)

    def origin(self, block: Mapping[str, Floats]) -> float | None:
        """The first stamp, in the column's own unit; None where there is none."""
        values = block[self.column]
        if self.fraction:  # rounded down, so that no row lies before it
            values = np.nextafter(values + block[self.fraction] * (self.fraction_unit / self.unit), -np.inf)
        finite = np.flatnonzero(np.isfinite(values))
        return float(values[finite[0]]) if len(finite) else None

    def seconds(self, block: Mapping[str, Floats], origin: float) -> Floats:
        """(n,) s since an origin, subtracted before scaling, so that clocks that count from 1970 lose no digits."""
        seconds = (block[self.column] - origin) * self.unit
        if self.fraction:
            seconds = seconds + block[self.fraction] * self.fraction_unit
        if self.is_text and 0.0 <= origin < _DAY:  # a time of day, over midnight
            steps = np.diff(seconds, prepend=seconds[:1])
            seconds = seconds + _DAY * np.cumsum(steps < -_DAY / 2)
        return np.asarray(seconds)


class Cut:
    """Selects the rows of a span by their time."""

    def __init__(self, span: TimeSpan, time: TimeColumns) -> None:
        self.span, self._time = span, time
        self.is_over = False

    def begin(self, place: int) -> None:
        """Mark the start of a part of the file, bytes or rows; the next span starts at the last one marked."""
        if not self.span.more:
            self.span.place = place

    def mask(self, block: Mapping[str, Floats]) -> NDArray[np.bool_]:
        """Which rows of the next block belong to the span."""
        if self.span.origin is None:
            self.span.origin = self._time.origin(block)
        elapsed = self._time.seconds(block, self.span.origin or 0.0)
        finite = elapsed[np.isfinite(elapsed)]
        self.is_over = bool(len(finite)) and self.span.is_past(float(finite.min()))
        return self.span.mask(elapsed)


def other_time(names: Sequence[str]) -> str | None:
    """A column that is a time by its name, None where there is none or more than one."""
    times = [name for name in names if _OTHER_NAME.match(name)]
    return times[0] if len(times) == 1 else None


def two_part(names: Sequence[str]) -> TimeColumns | None:
    """The time of a table with whole seconds in one column and the rest in another, None where there is no pair."""
    seconds = [name for name in names if _SECONDS.match(name)]
    parts = [(name, UNITS[unit]) for unit, form in _FRACTIONS.items() for name in names if form.match(name)]
    if len(seconds) != 1 or len(parts) != 1:
        return None
    return TimeColumns(seconds[0], fraction=parts[0][0], fraction_unit=parts[0][1])


def is_text(cells: Sequence[str]) -> bool:
    """Whether the cells of a time column are times as text."""
    filled = [cell for cell in cells if cell.strip()]
    return bool(filled) and is_clock(filled[0])


def rates_of(period: float) -> dict[str, float]:
    """The rate of rows, Hz, by the unit that their period is in."""
    return {unit: 1.0 / (period * size) for unit, size in UNITS.items()}


def units_of(period: float) -> list[str]:
    """Units in which a period between rows is that of a flight log: a usual one, or else any that there is."""
    rates = rates_of(period)
    usual = [unit for unit, rate in rates.items() if USUAL_RATES[0] <= rate <= USUAL_RATES[1]]
    return usual or [unit for unit, rate in rates.items() if MIN_RATE <= rate <= MAX_RATE]


def unit_by_rate(stamps: Floats, column: str, names: Sequence[str]) -> tuple[float, str]:
    """The unit of a table's stamps in which its rate is a flight's, s, and its name; seconds where that may be.

    names: of the table's columns.
    Raises DataError where two units would do, or none.
    """
    steps = np.diff(stamps[np.isfinite(stamps)])
    steps = np.abs(steps[steps != 0])
    if not len(steps):
        return 1.0, "s"
    period = float(np.median(steps))
    rates = rates_of(period)
    is_fast = any((quantity := quantity_of(name)) is not None and quantity.name in FAST for name in names)
    if rates["s"] > (MIN_RATE if is_fast else MIN_RATE_OF_POSITION):
        return 1.0, "s"
    possible = units_of(period)
    if len(possible) == 1:
        return UNITS[possible[0]], possible[0]
    shown = " or ".join(f"{unit} ({rates[unit]:.3g} Hz)" for unit in possible) or "none of s, ms, us, ns"
    raise DataError(
        f"{column} steps by {period:.3g}, which is no flight's rate: the time is not in seconds; its unit may be "
        f"{shown}. Wanted seconds; divide it, or give a column mapping with its unit (ms, us, ns)."
    )
