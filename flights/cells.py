"""Cells of tables that are no plain numbers: lists, as pandas and numpy print them, and times as text."""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from dynamics.arrays import Floats
from dynamics.errors import DataError

_ELEMENT = re.compile(r"(?P<column>.+)\[(?P<index>\d{1,3})\]$")
_DAY = 86_400.0
_NOT_A_NUMBER = ("none", "null", "na", "<na>", "-nan", "nat")
# What stands around the numbers of a list: np.float64(...), array([...], dtype=float32), tensor(...).
_AROUND = (
    r"(?:\b(?:np|numpy|torch|jnp)\.)?\b(?:array|tensor|asarray|u?int\d*|float\d*|double)\(|dtype=[\w.]+|device=\S+"
)
_BETWEEN = r"[\[\](){},;\s]+"
_TIME = r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,](?P<part>\d+))?)?\s*(?P<half>[ap]m)?"
_ZONE = r"\s*(?P<zone>z|utc|gmt|[+-]\d{2}:?\d{2})?$"
_DATES = (
    r"(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})(?:[t_,]|\s)\s*",
    r"(?P<day>\d{1,2})\.(?P<month>\d{1,2})\.(?P<year>\d{4})[t_,\s]\s*",
    r"(?P<month>\d{1,2})/(?P<day>\d{1,2})/(?P<year>\d{4})[t_,\s]\s*",
    "",
)
_BASIC = (  # ISO 8601 without separators
    r"\s*(?P<year>\d{4})(?P<month>\d{2})(?P<day>\d{2})[t_](?P<hour>\d{2})(?P<minute>\d{2})(?P<second>\d{2})"
    rf"(?:[.,](?P<part>\d+))?{_ZONE}"
)
_CLOCKS = tuple(re.compile(form, re.IGNORECASE) for form in (*(rf"\s*{date}{_TIME}{_ZONE}" for date in _DATES), _BASIC))


def element_of(name: str, columns: Collection[str]) -> tuple[str, int] | None:
    """Column and index of an element such as `p[0]` of a column of lists, None where a column has that very name."""
    match = None if name in columns else _ELEMENT.match(name)
    return (match["column"], int(match["index"])) if match is not None and match["column"] in columns else None


def elements_of_texts(column: pa.Array | pa.ChunkedArray, indices: Iterable[int]) -> dict[int, Floats]:
    """(n,) each element of cells such as "[1.0, 2.0]" or "[1. 2.]"; NaN where a cell has fewer.

    Raises DataError for cells that hold something else than numbers.
    """
    texts = pc.utf8_lower(column.cast(pa.string()))
    texts = pc.replace_substring_regex(texts, _AROUND, " ")
    texts = pc.utf8_trim(pc.replace_substring_regex(texts, _BETWEEN, " "), " ")
    parts = pc.split_pattern(texts, " ")
    parts = parts.combine_chunks() if isinstance(parts, pa.ChunkedArray) else parts
    flat = parts.flatten()
    flat = pc.if_else(pc.is_in(flat, pa.array([*_NOT_A_NUMBER, ""])), pa.scalar(None, pa.string()), flat)
    try:
        numbers = flat.cast(pa.float64()).to_numpy(zero_copy_only=False).astype(float)
    except pa.ArrowInvalid as error:
        raise DataError(
            f"its cells cannot be read as lists of numbers: {error}. Wanted [1.0, 2.0] or [1. 2.]."
        ) from None
    return _elements(numbers, parts, indices)


def elements_of_lists(column: pa.ChunkedArray, indices: Iterable[int]) -> dict[int, Floats]:
    """(n,) each element of a Parquet column of lists; NaN where a cell has fewer. Raises DataError for no numbers."""
    parts = column.combine_chunks()
    parts = parts.combine_chunks() if isinstance(parts, pa.ChunkedArray) else parts
    try:
        numbers = np.asarray(parts.flatten().cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        raise DataError(f"its lists hold {parts.type}, wanted numbers.") from None
    return _elements(numbers, parts, indices)


def _elements(numbers: Floats, parts: pa.Array, indices: Iterable[int]) -> dict[int, Floats]:
    """Elements of flattened lists. numbers: of all cells, one after the other."""
    length = pc.fill_null(pc.list_value_length(parts), 0).to_numpy(zero_copy_only=False).astype(int)
    start = np.cumsum(length) - length
    padded = np.append(numbers, np.nan)
    return {index: padded[np.where(index < length, start + index, len(numbers))] for index in indices}


def seconds_of_clock(texts: Sequence[str | None]) -> Floats:
    """(n,) s of times as text: ISO 8601, day.month.year, month/day/year, or a time of day; since 1970 where dated.

    Raises DataError for text that is no time.
    """
    seconds = np.full(len(texts), np.nan)
    read: Callable[[str], float] | None = None
    for row, text in enumerate(texts):
        if text is None or not text.strip() or text.strip().lower() in ("nan", *_NOT_A_NUMBER):
            continue
        read = read or _reader_of(text)
        try:
            seconds[row] = np.nan if read is None else read(text)
        except ValueError:
            read = _reader_of(text)  # a shorter form of the same, as without a fraction
            seconds[row] = np.nan if read is None else read(text)
        if read is None:
            raise DataError(
                f"{text!r} is no time. Wanted ISO 8601 (2026-04-01T10:22:31.250), 01.04.2026 10:22:31,250, or "
                "10:22:31.250."
            )
    return seconds


def is_clock(text: str) -> bool:
    """Whether a cell is a time as text."""
    return any(pattern.match(text) for pattern in _CLOCKS)


def _reader_of(text: str) -> Callable[[str], float] | None:
    """The reading of texts of this one's form, None where it is no time."""
    pattern = next((pattern for pattern in _CLOCKS if pattern.match(text)), None)
    if pattern is None:
        return None

    def read(cell: str) -> float:
        match = pattern.match(cell)
        if match is None:
            raise ValueError(cell)
        return _seconds(match.groupdict())

    return read


def _seconds(parts: Mapping[str, str | None]) -> float:
    """Raises DataError for a day or an hour that there is not."""
    hour, minute, second = (int(parts.get(name) or 0) for name in ("hour", "minute", "second"))
    half = (parts.get("half") or "").lower()
    hour = hour % 12 + 12 * (half == "pm") if half else hour
    if hour > 24 or minute > 59 or second > 60:
        raise DataError(f"{hour}:{minute:02}:{second:02} is no time of day. Correct the time column.")
    fraction = parts.get("part") or ""
    day = _days(parts["year"], parts["month"], parts["day"]) if parts.get("year") else 0
    seconds = day * _DAY + hour * 3600 + minute * 60 + second - _zone(parts.get("zone"))
    return seconds + (int(fraction) / 10 ** len(fraction) if fraction else 0.0)


@cache
def _days(year: str, month: str, day: str) -> int:
    """Days since 1970; of a month beyond 12 the day is the month."""
    months, days = int(month), int(day)
    if months > 12:
        months, days = days, months
    try:
        return (datetime.date(int(year), months, days) - datetime.date(1970, 1, 1)).days
    except ValueError:
        raise DataError(f"{year}-{month}-{day} is no date. Correct the time column.") from None


def _zone(text: str | None) -> int:
    """Seconds east of UTC."""
    if not text or text[0] not in "+-":
        return 0
    digits = text[1:].replace(":", "")
    return (1 if text[0] == "+" else -1) * (int(digits[:2]) * 3600 + int(digits[2:]) * 60)
