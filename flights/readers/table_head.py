"""The head of a text table: what separates its cells, its columns' names, and its first rows."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from flights.source import HEAD_BYTES, Source

MAX_HEADER = 60_000  # letters
_ROWS = 200
_SEPARATORS = ",;\t"
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(e[+-]?\d+)?$", re.IGNORECASE)
_DECIMAL_POINT = re.compile(r"[+-]?\d*\.\d+(e[+-]?\d+)?$", re.IGNORECASE)
_STATED = re.compile(r'"?sep=(.)"?$', re.IGNORECASE)  # Excel's own line before the header


@dataclass(frozen=True)
class TableHead:
    """The head of a text table.

    names: of all columns.
    lines: up to the header, the header included.
    rows: the cells of its first rows, as text.
    """

    names: list[str]
    delimiter: str
    decimal: str
    lines: int
    rows: Sequence[Sequence[str]]

    def cells(self, name: str) -> list[str]:
        """The first cells of a column."""
        index = self.names.index(name)
        return [row[index].strip() for row in self.rows if len(row) == len(self.names)]

    def numbers(self, name: str) -> Floats:
        """The first numbers of a column; NaN where a cell is none."""
        return np.array([_number(cell.replace(self.decimal, ".")) for cell in self.cells(name)], dtype=float)


def names_of(line: str, delimiter: str = ",") -> list[str]:
    """Column names of a header, which some tools write as a comment."""
    line = line.removeprefix("#")
    return [name.strip().strip('"') for name in line.split(delimiter)]


def table_head(source: Source) -> TableHead | None:
    """The head of a text table whose first line names its columns, None for a file that is none."""
    first = source.first_line()
    if not first or len(first) > MAX_HEADER:
        return None
    lines = lines_of(source)
    stated = _STATED.match(lines[0]) if lines else None
    if stated is not None:
        first, lines = (lines[1].strip() if len(lines) > 1 else ""), lines[1:]
    delimiter = stated[1] if stated is not None else max(_SEPARATORS, key=first.count)
    names = names_of(first, delimiter)
    if len(names) < 2:
        return None
    rows = _cells(lines[1 : 1 + _ROWS], delimiter)
    return TableHead(names, delimiter, decimal_of(rows), 1 if stated is None else 2, rows)


def _cells(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    try:
        return list(csv.reader(lines, delimiter=delimiter))
    except csv.Error:  # damage, which reading the rows will name
        return []


def lines_of(source: Source) -> list[str]:
    """The first whole lines of a text, none of a file that is none."""
    if b"\0" in source.head:
        return []
    lines = [line.rstrip("\r") for line in source.head.decode("utf-8-sig", "replace").split("\n")]
    return lines[:-1] if len(source.head) == HEAD_BYTES else lines


def is_decimal_comma(cell: str) -> bool:
    """Whether a cell is a number with a decimal comma."""
    return _DECIMAL_COMMA.match(cell) is not None


def decimal_of(rows: Sequence[Sequence[str]]) -> str:
    """The decimal sign of cells."""
    cells = [cell.strip() for row in rows for cell in row]
    commas = any(_DECIMAL_COMMA.match(cell) for cell in cells)
    return "," if commas and not any(_DECIMAL_POINT.match(cell) for cell in cells) else "."


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
