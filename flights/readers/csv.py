"""The flight CSV: the columns of `flights.quantities` by name, in any order, with `t` in seconds."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
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
from flights.cells import element_of, elements_of_texts, is_clock, seconds_of_clock
from flights.log import LogContent
from flights.quantities import PRIMARY, QUANTITIES, all_parts, known_columns, quantity_of
from flights.readers.table_head import TableHead, is_decimal_comma, table_head
from flights.readers.unnamed_columns import columns_of, keep_unnamed, unnamed_columns
from flights.source import Source
from flights.table_time import Cut, TimeColumns, is_text, other_time, two_part, unit_by_rate
from flights.tables import TIME

FLIGHT_TIME = TimeColumns(TIME)
TIME_UNIT = "time_unit"  # name of the repair of a time that is in no seconds
_BLANKS = ["", "nan", "NaN", "NAN", "-nan", "null", "NULL", "None", "NA", "N/A"]
_BLOCK = 1 << 20
_SECTION = 8 << 20  # bytes of a long file that are parsed together
MIN_SLOWER = 10  # rows of a quantity from which on its own rate shows
MAX_JITTER, MIN_REGULAR = 0.25, 0.9  # of its period; share of its periods that are within
_MAX_TORN = 0.01  # share of rows with another number of cells than the header


@dataclass(frozen=True)
class Layout:
    """Layout of a text table.

    names: of all columns in the file's order.
    decimal: what stands before the fraction of a number.
    lines: up to the header, the header included.
    clocks: columns of times as text, which are read as seconds.
    cut: the rows to select, None for all.
    prefix: what precedes the cells in every line.
    """

    names: Sequence[str]
    delimiter: str = ","
    decimal: str = "."
    lines: int = 1
    clocks: frozenset[str] = frozenset()
    cut: Cut | None = None
    prefix: re.Pattern[bytes] | None = None


def matches(source: Source) -> bool:
    """Whether it is text whose header names the time and a column of a flight."""
    return _flight_table(source) is not None


def read(source: Source) -> LogContent:
    """The streams of a flight CSV. Raises DataError for an inconsistent one."""
    table = _flight_table(source)
    if table is None:
        raise DataError(f"its columns are none of a flight's. Wanted {TIME} and columns of the flight CSV.")
    assembly = Assembly()
    head, time = table
    if not time.is_text and not time.fraction:
        unit, name = unit_by_rate(head.numbers(time.column), time.column, head.names)
        if unit != 1.0:
            assembly.repair(
                TIME_UNIT, f"{time.column} is in {name} by its rate of rows, and not in s as the flight CSV's is"
            )
            time = replace(time, unit=unit)
    _note_form(head, time, assembly)
    cut = None if source.span is None else Cut(source.span, time)
    clocks = frozenset({time.column}) if time.is_text else frozenset[str]()
    layout = Layout(head.names, head.delimiter, head.decimal, head.lines, clocks, cut)
    names = _without_duplicates(head.names, assembly)

    def numbers(used: Sequence[str]) -> dict[str, Floats]:
        return read_columns(source.file, layout, used, assembly)

    used = [name for name in names if quantity_of(name) is not None or name in time.names]
    unnamed = unnamed_columns(names, used)
    columns = readable_columns(numbers, *needed_columns(names, time), assembly, columns_of(unnamed))
    is_plain = time == TimeColumns(TIME, unit=time.unit)
    origin = 0.0 if is_plain else time.origin(columns) or 0.0
    columns[TIME] = time.seconds(columns, origin)
    assembly.origin = origin * time.unit
    if len(columns[TIME]):
        add_table(assembly, columns, [name for name in names if name not in time.names])
        keep_unnamed(assembly, unnamed, columns)
    return assembly.finish(keep_time=is_plain)


def _flight_table(source: Source) -> tuple[TableHead, TimeColumns] | None:
    """Head and time of a table with a flight's columns, None for any other file."""
    head = table_head(source)
    if head is None or not any(quantity_of(name) is not None for name in head.names):
        return None
    time = two_part(head.names) if TIME not in head.names else None
    if time is not None:
        return head, time
    column = next((name for name in head.names if name == TIME), None) or other_time(head.names)
    return None if column is None else (head, TimeColumns(column, is_text=is_text(head.cells(column))))


def _note_form(head: TableHead, time: TimeColumns, assembly: Assembly) -> None:
    """Say what of a table's form is no flight CSV's."""
    if head.decimal != ".":
        assembly.note(f"cells are separated by {head.delimiter!r} and numbers have decimal commas")
    if time.is_text:
        assembly.note(f"{time.column} holds times of a clock as text, counted from the first row")
    elif time.fraction:
        assembly.note(f"time is {time.column} and {time.fraction}, counted from the first row")
    elif time.column != TIME:
        assembly.note(f"time is {time.column}, counted from the first row")


def needed_columns(names: Sequence[str], time: TimeColumns = FLIGHT_TIME) -> tuple[list[str], dict[str, list[str]]]:
    """Of a flight table's columns the time and those that the physics needs, and the secondary ones by quantity."""
    primary, secondary = list(time.names), dict[str, list[str]]()
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
    """The columns of these names, and the defect of each dropped row. strict: drop none, which is fast.

    A name such as p[0] is an element of a column p of lists.
    """
    torn: list[str] = []
    elements = {name: element for name in names if (element := element_of(name, layout.names)) is not None}
    columns = list(dict.fromkeys(elements[name][0] if name in elements else name for name in names))
    of_text = {column for column, _ in elements.values()} | layout.clocks

    def drop(row: pa_csv.InvalidRow) -> str:
        torn.append(f"{row.actual_columns} instead of {row.expected_columns} cells")
        return "skip"

    keys = [f"{index}:{name}" for index, name in enumerate(layout.names)]  # names may be blank or there twice
    key_of = {column: keys[layout.names.index(column)] for column in columns}
    # in Latin-1 every byte is a letter, so that a damaged row can be recognised
    encoding = "utf8" if strict else "latin-1"
    read = pa_csv.ReadOptions(column_names=keys, block_size=_BLOCK, encoding=encoding, use_threads=False)
    parse = pa_csv.ParseOptions(
        delimiter=layout.delimiter,
        invalid_row_handler=None if strict else drop,
        newlines_in_values=bool(elements),  # numpy breaks long lists into lines
    )
    convert = pa_csv.ConvertOptions(
        column_types={key: pa.string() if column in of_text else pa.float64() for column, key in key_of.items()},
        include_columns=list(key_of.values()),
        null_values=_BLANKS,
        strings_can_be_null=True,
        decimal_point=layout.decimal,
    )
    parts: dict[str, list[Floats]] = {name: [] for name in names}
    try:
        for start, section in _sections(file, layout):
            read.skip_rows = 0 if start else layout.lines
            with pa_csv.open_csv(section, read_options=read, parse_options=parse, convert_options=convert) as reader:
                for batch in reader:
                    block = _block(dict(zip(columns, batch.columns, strict=True)), names, elements, layout.clocks)
                    rows = slice(None) if layout.cut is None else layout.cut.mask(block)
                    for name, values in block.items():
                        parts[name].append(values[rows])
            if layout.cut is not None and layout.cut.is_over:
                break
    except pa.ArrowInvalid as error:
        raise DataError(
            f"its rows cannot be read as numbers: {error}. Wanted a number or nothing in each cell."
            f"{_advice(str(error))}"
        ) from None
    return {name: np.concatenate(blocks or [np.empty(0)]) for name, blocks in parts.items()}, torn


def _advice(error: str) -> str:
    """The line of a mapping that reads the cell which an error shows, empty for none."""
    match = re.search(r"invalid value '(.+?)'", error)
    cell = "" if match is None else match[1].strip()
    if cell.startswith(("[", "(", "array")):
        return " For cells that are lists, name their elements in a mapping: p[0], p[1], p[2]."
    if is_clock(cell):
        return " For times as text, give unit = 'iso' under [time] of the mapping."
    if is_decimal_comma(cell):
        return " For decimal commas, give decimal = ',' under [file] of the mapping."
    return ""


def _block(
    columns: Mapping[str, pa.Array],
    names: Sequence[str],
    elements: Mapping[str, tuple[str, int]],
    clocks: frozenset[str],
) -> dict[str, Floats]:
    """The numbers of a block of rows by name. elements: column and index of the names that are parts of lists."""
    lists: dict[str, dict[int, Floats]] = {}
    for column in {column for column, _ in elements.values()}:
        try:
            lists[column] = elements_of_texts(columns[column], {i for of, i in elements.values() if of == column})
        except DataError as error:
            raise DataError(f"{column}: {error}") from None
    return {
        name: lists[elements[name][0]][elements[name][1]]
        if name in elements
        else seconds_of_clock(columns[name].to_pylist())
        if name in clocks
        else columns[name].to_numpy(zero_copy_only=False).astype(float)
        for name in names
    }


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
            if place or text.count(b"\n") > layout.lines or not text.endswith(b"\n"):  # more than a header by itself
                yield place, pa.BufferReader(text)
            place += sum(map(len, lines))


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
