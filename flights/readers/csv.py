"""The flight CSV: the columns of `flights.quantities` by name, in any order, with `t` in seconds."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.spelling import nearest
from flights.assembly import Assembly
from flights.log import LogContent
from flights.quantities import PRIMARY, QUANTITIES, all_parts, known_columns, quantity_of
from flights.readers.unnamed_columns import columns_of, keep_unnamed, unnamed_columns
from flights.source import Source, TimeSpan
from flights.tables import TIME

_BLANKS = ["", "nan", "NaN", "NAN", "-nan", "null", "NULL", "None", "NA", "N/A"]
_BLOCK = 1 << 20
_SECTION = 8 << 20  # bytes of a long file that are parsed together
MIN_SLOWER = 10  # rows of a quantity from which on its own rate shows
MAX_JITTER, MIN_REGULAR = 0.25, 0.9  # of its period; share of its periods that are within
_MAX_TORN = 0.01  # share of rows with another number of cells than the header


class Cut:
    """Selects the rows of a span by their time.

    column: of the time.
    unit: of the time, s.
    """

    def __init__(self, span: TimeSpan, column: str, unit: float = 1.0) -> None:
        self.span, self._column, self._unit = span, column, unit
        self.is_over = False

    def begin(self, place: int) -> None:
        """Mark the start of a part of the file, bytes or rows; the next span starts at the last one marked."""
        if not self.span.more:
            self.span.place = place

    def mask(self, block: Mapping[str, Floats]) -> NDArray[np.bool_]:
        """Which rows of the next block belong to the span."""
        time = block[self._column]
        finite = time[np.isfinite(time)]
        if self.span.origin is None and len(finite):
            self.span.origin = float(finite[0])
        origin = self.span.origin or 0.0
        self.is_over = bool(len(finite)) and self.span.is_past((float(finite.min()) - origin) * self._unit)
        return self.span.mask((time - origin) * self._unit)


@dataclass(frozen=True)
class Layout:
    """Layout of a text table.

    names: of all columns in the file's order.
    cut: the rows to select, None for all.
    prefix: what precedes the cells in every line.
    """

    names: Sequence[str]
    delimiter: str = ","
    cut: Cut | None = None
    prefix: re.Pattern[bytes] | None = None


def matches(source: Source) -> bool:
    """Whether it is text whose first line names the time and a column of a flight."""
    names = names_of(source.first_line())
    return TIME in names and any(quantity_of(name) is not None for name in names)


def read(source: Source) -> LogContent:
    """The streams of a flight CSV. Raises DataError for an inconsistent one."""
    assembly = Assembly()
    names = names_of(source.first_line())
    layout = Layout(names, cut=None if source.span is None else Cut(source.span, TIME))
    names = _without_duplicates(names, assembly)

    def numbers(used: Sequence[str]) -> dict[str, Floats]:
        return read_columns(source.file, layout, used, assembly)

    unnamed = unnamed_columns(names, [name for name in names if quantity_of(name) is not None])
    columns = readable_columns(numbers, *needed_columns(names), assembly, columns_of(unnamed))
    if len(columns[TIME]):
        add_table(assembly, columns, names)
        keep_unnamed(assembly, unnamed, columns)
    return assembly.finish(keep_time=True)


def needed_columns(names: Sequence[str]) -> tuple[list[str], dict[str, list[str]]]:
    """Of a flight table's columns the time and those that the physics needs, and the secondary ones by quantity."""
    primary, secondary = [TIME], dict[str, list[str]]()
    for name in names:
        quantity = quantity_of(name)
        if quantity is not None:
            (primary if quantity.name in PRIMARY else secondary.setdefault(quantity.name, [])).append(name)
    return primary, secondary


def readable_columns(
    read: Callable[[Sequence[str]], dict[str, Floats]],
    primary: Sequence[str],
    secondary: Mapping[str, Sequence[str]],
    assembly: Assembly,
    unnamed: Sequence[str] = (),
) -> dict[str, Floats]:
    """Columns by name, without the secondary quantities whose own cannot be read.

    read: the columns of given names. primary: names, that of the time first. secondary: names by quantity.
    unnamed: names of columns that are no flight's, read where they are numbers.
    Raises DataError where a primary one cannot be read.
    """
    named = [*primary, *chain.from_iterable(secondary.values())]
    try:
        return read([*named, *unnamed])
    except DataError:
        if unnamed:
            return readable_columns(read, primary, secondary, assembly)
        columns = read(primary)
    for quantity, names in secondary.items():
        try:
            columns |= read([primary[0], *names])
        except DataError as error:
            assembly.repair("stream_left_out", f"{quantity}: {error} It is left out.")
    return columns


def add_table(assembly: Assembly, columns: dict[str, Floats], names: Sequence[str]) -> None:
    """Add streams from columns of a flight table. names: all columns of the file; others than a flight's become notes.

    Raises DataError when a part of a primary quantity is missing; a secondary one is left out.
    """
    time = columns[TIME]
    grouped: dict[str, list[str]] = {}
    for name in names:
        quantity = quantity_of(name)
        if quantity is not None:
            grouped.setdefault(quantity.name, []).append(name)
        elif name not in (TIME, ""):
            assembly.note(f"column {name!r} is no column of a flight and is left out{nearest(name, known_columns())}")
    for name in QUANTITIES:
        if name not in grouped or not columns.keys() >= set(grouped[name]):
            continue
        try:
            parts = all_parts(QUANTITIES[name], grouped[name])
        except DataError as error:
            if name in PRIMARY:
                raise
            assembly.repair("stream_left_out", f"{error} {name} is left out.")
            continue
        table = np.stack([columns[part] for part in parts], axis=1)
        logged = _slower_rows(table)
        stamps, table = time[logged], table[logged]
        blank = int(np.count_nonzero(~np.isfinite(table).all(axis=1)))
        if blank:
            assembly.repair("missing_values", f"{name}: {blank} of {len(stamps)} rows without a number masked")
        assembly.add(name, stamps, table, ", ".join((parts[0], "...", parts[-1]) if len(parts) > 2 else parts))


def _slower_rows(table: Floats) -> NDArray[np.int64]:
    """The rows of a quantity that was logged less often than the table's other ones, in between which it is blank.

    All rows, if it is blank in fewer than every second one, or here and there. table: (n, k).
    """
    filled = np.flatnonzero(np.isfinite(table).any(axis=1))
    apart = np.diff(filled)
    usual = np.median(apart) if len(filled) >= MIN_SLOWER else 0.0
    regular = usual >= 2 and np.mean(np.abs(apart - usual) <= MAX_JITTER * usual) >= MIN_REGULAR
    return filled if regular else np.arange(len(table))


def read_columns(file: Path, layout: Layout, names: Sequence[str], assembly: Assembly) -> dict[str, Floats]:
    """Columns of a delimited text file as numbers, read in blocks; blank cells are NaN.

    Rows with another number of cells, as a torn last one, are dropped and named. Raises DataError when cells are no
    numbers or many rows are torn.
    """
    try:
        columns, torn = _parsed(file, layout, names, strict=True)
    except DataError:
        columns, torn = _parsed(file, layout, names, strict=False)
    rows = len(columns[names[0]])
    if not rows and layout.cut is None:
        raise DataError("it has a header but no rows. Wanted at least one sample.")
    if torn:
        if len(torn) > max(1, _MAX_TORN * rows):
            raise DataError(f"{len(torn)} of {rows + len(torn)} rows have {torn[0]}. Wanted as many cells as columns.")
        assembly.repair("torn_rows", f"{len(torn)} rows with {torn[0]} dropped")
    return columns


def _parsed(file: Path, layout: Layout, names: Sequence[str], *, strict: bool) -> tuple[dict[str, Floats], list[str]]:
    """The columns of these names, and the defect of each dropped row. strict: drop none, which is fast."""
    torn: list[str] = []

    def drop(row: pa_csv.InvalidRow) -> str:
        torn.append(f"{row.actual_columns} instead of {row.expected_columns} cells")
        return "skip"

    keys = [f"{index}:{name}" for index, name in enumerate(layout.names)]  # names may be blank or there twice
    included = [keys[layout.names.index(name)] for name in names]
    # in Latin-1 every byte is a letter, so that a damaged row can be recognised
    encoding = "utf8" if strict else "latin-1"
    read = pa_csv.ReadOptions(column_names=keys, block_size=_BLOCK, encoding=encoding, use_threads=False)
    parse = pa_csv.ParseOptions(delimiter=layout.delimiter, invalid_row_handler=None if strict else drop)
    convert = pa_csv.ConvertOptions(
        column_types=dict.fromkeys(included, pa.float64()), include_columns=included, null_values=_BLANKS
    )
    parts: dict[str, list[Floats]] = {name: [] for name in names}
    try:
        for start, section in _sections(file, layout):
            read.skip_rows = 0 if start else 1
            with pa_csv.open_csv(section, read_options=read, parse_options=parse, convert_options=convert) as reader:
                for batch in reader:
                    block = {
                        name: column.to_numpy(zero_copy_only=False).astype(float)
                        for name, column in zip(names, batch.columns, strict=True)
                    }
                    rows = slice(None) if layout.cut is None else layout.cut.mask(block)
                    for name, values in block.items():
                        parts[name].append(values[rows])
            if layout.cut is not None and layout.cut.is_over:
                break
    except pa.ArrowInvalid as error:
        raise DataError(
            f"its rows cannot be read as numbers: {error}. Wanted a number or nothing in each cell."
        ) from None
    return {name: np.concatenate(blocks or [np.empty(0)]) for name, blocks in parts.items()}, torn


def _sections(file: Path, layout: Layout) -> Iterator[tuple[int, Path | pa.BufferReader]]:
    """Parts to parse with their places in the file: all of it, or sections from where a span starts."""
    cut, prefix = layout.cut, layout.prefix
    if cut is None and prefix is None:
        yield 0, file
        return
    with file.open("rb") as stream:
        place = 0 if cut is None else cut.span.place or 0
        stream.seek(place)
        while lines := stream.readlines(_SECTION):
            if cut is not None:
                cut.begin(place)
            bare = lines if prefix is None else [prefix.sub(b"", line, count=1) for line in lines]
            text = b"".join(bare)
            if place or text.count(b"\n") > 1 or not text.endswith(b"\n"):  # more than a header by itself
                yield place, pa.BufferReader(text)
            place += sum(map(len, lines))


def names_of(line: str, delimiter: str = ",") -> list[str]:
    """Column names of a header, which some tools write as a comment."""
    line = line.removeprefix("#")
    return [name.strip().strip('"') for name in line.split(delimiter)]


def _without_duplicates(names: Sequence[str], assembly: Assembly) -> list[str]:
    """The names without secondary columns that are there more than once. Raises DataError for others."""
    twice = sorted({name for name in names if name and names.count(name) > 1})
    needed = [name for name in twice if (quantity := quantity_of(name)) is None or quantity.name in PRIMARY]
    if needed:
        raise DataError(
            f"the columns {', '.join(needed)} are there more than once. Wanted each once; remove the others."
        )
    if twice:
        assembly.repair("stream_left_out", f"{', '.join(twice)}: columns that are there more than once left out")
    return [name for name in names if name not in twice]
