"""Parquet files with the columns of the flight CSV, ours or anybody's."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet

from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.unpacking import Unpacking
from flights.assembly import Assembly
from flights.cells import element_of, elements_of_lists, elements_of_texts, seconds_of_clock
from flights.log import LogContent
from flights.quantities import quantity_of
from flights.readers import csv
from flights.readers.unnamed_columns import columns_of, keep_unnamed, unnamed_columns
from flights.source import Source
from flights.table_time import Cut, TimeColumns, unit_by_rate
from flights.tables import TIME, decode_notes

BATCH_ROWS = 1 << 16  # that are unpacked at once
_HEAD_ROWS = 200


def matches(source: Source) -> bool:
    """Whether it begins as a Parquet file does."""
    return source.head.startswith(b"PAR1")


def read(source: Source) -> LogContent:
    """The streams of a Parquet file. Raises DataError for a torn one or one without the columns of a flight."""
    assembly = Assembly()
    names = names_of(source)
    used = [name for name in names if name == TIME or quantity_of(name) is not None]
    if TIME not in used or len(used) < 2:
        raise DataError(
            f"this Parquet file has the columns {', '.join(names[:12])}; wanted {TIME} and columns of the flight CSV, "
            "as position_x. Rename them, or give a column mapping."
        )
    unnamed = unnamed_columns(names, used)
    with _opened(source) as file:
        notes = decode_notes(file.schema_arrow.metadata)
        clocks = frozenset(name for name in (TIME,) if _is_clock(file.schema_arrow.field(name).type))
    time = TimeColumns(TIME, is_text=bool(clocks))
    if notes is None and not clocks:
        unit, name = unit_by_rate(_first_rows(source, TIME), TIME, names)
        time = TimeColumns(TIME, unit)
        if unit != 1.0:
            assembly.repair(
                csv.TIME_UNIT, f"{TIME} is in {name} by its rate of rows, and not in s as the flight CSV's is"
            )
    cut = None if source.span is None else Cut(source.span, time)

    def numbers(some: Sequence[str]) -> dict[str, Floats]:
        return read_columns(source, some, cut, clocks)

    columns = csv.readable_columns(numbers, *csv.needed_columns(names), assembly, columns_of(unnamed))
    origin = (time.origin(columns) or 0.0) if clocks else 0.0
    columns[TIME] = time.seconds(columns, origin)
    assembly.origin = origin
    if len(columns[TIME]):
        csv.add_table(assembly, columns, names)
        keep_unnamed(assembly, unnamed, columns)
    if notes is not None:
        assembly.metadata |= notes.metadata
        assembly.parameters |= notes.parameters
        assembly.note(f"made from {notes.provenance.path} ({notes.provenance.format}, {notes.provenance.sha256[:12]})")
        for repair in notes.provenance.repairs:
            assembly.note(f"repaired when it was made: {repair}")
    return assembly.finish(keep_time=not clocks)


def _first_rows(source: Source, name: str) -> Floats:
    """The first numbers of a column, NaN where they are none; of the first row group alone."""
    with _opened(source) as file:
        for batch in file.iter_batches(_HEAD_ROWS, columns=[name]):
            return _numbers(pa.chunked_array([batch.column(0)]), name)
    return np.empty(0)


@contextmanager
def _opened(source: Source) -> Iterator[pa_parquet.ParquetFile]:
    try:
        with pa_parquet.ParquetFile(source.file) as file:
            yield file
    except (pa.ArrowInvalid, OSError) as error:
        raise DataError(f"this Parquet file is torn or damaged: {error}. Wanted a whole one; write it again.") from None


def names_of(source: Source) -> tuple[str, ...]:
    """The names of its columns. Raises DataError for a torn file."""
    with _opened(source) as file:
        return tuple(file.schema_arrow.names)


def read_columns(
    source: Source, used: Sequence[str], cut: Cut | None, clocks: Collection[str] = ()
) -> dict[str, Floats]:
    """Columns as numbers, all rows or those that a cut selects. Raises DataError for a torn file and for no numbers.

    A name such as p[0] is an element of a column p of lists. clocks: columns of times, which are read as seconds.
    """
    with _opened(source) as file:
        return _columns(file, source, used, cut, clocks)


def _columns(
    file: pa_parquet.ParquetFile, source: Source, names: Sequence[str], cut: Cut | None, clocks: Collection[str]
) -> dict[str, Floats]:
    """The used columns, all rows or those of a span, for which only the row groups of the span are read."""
    present = file.schema_arrow.names
    elements = {name: element for name in names if (element := element_of(name, present)) is not None}
    used = list(dict.fromkeys(elements[name][0] if name in elements else name for name in names))

    def block_of(table: pa.Table) -> dict[str, Floats]:
        return {name: _cells(table, name, elements.get(name), is_clock=name in clocks) for name in names}

    if cut is None:
        return block_of(_within_limits(file, source, used, range(file.num_row_groups)))
    parts: dict[str, list[Floats]] = {name: [] for name in names}
    for group in range(cut.span.place or 0, file.num_row_groups):
        cut.begin(group)
        table = _within_limits(file, source, used, [group])
        block = block_of(table)
        rows = cut.mask(block)
        for name, values in block.items():
            parts[name].append(values[rows])
        if cut.is_over:
            break
    return {name: np.concatenate(blocks or [np.empty(0)]) for name, blocks in parts.items()}


def _within_limits(
    file: pa_parquet.ParquetFile, source: Source, used: Sequence[str], groups: Sequence[int]
) -> pa.Table:
    """Row groups, read in steps. Raises RequestError where they unpack beyond the limits, before or while they do.

    Pages of equal values take a few bytes however many they are: it is the numbers that fill the memory.
    """
    size = source.file.stat().st_size
    declared = sum(_unpacked_size(file.metadata.row_group(group), used) for group in groups)
    Unpacking(source.path, size).add_bytes(declared, size)
    unpacking, batches = Unpacking(source.path, size), []
    for batch in file.iter_batches(BATCH_ROWS, row_groups=list(groups), columns=list(used)):
        unpacking.add_bytes(batch.nbytes, size)
        batches.append(batch)
    schema = pa.schema([file.schema_arrow.field(name) for name in used])
    return pa.Table.from_batches([batch.select(list(used)) for batch in batches], None if batches else schema)


def _unpacked_size(group: pa_parquet.RowGroupMetaData, used: Sequence[str]) -> int:
    """Bytes that a row group declares for the used columns, as pages or as numbers, whichever is more."""
    columns = [group.column(index) for index in range(group.num_columns)]
    pages = sum(
        column.total_uncompressed_size
        for column in columns
        if {column.path_in_schema, column.path_in_schema.partition(".")[0]} & set(used)
    )
    return max(int(pages), 8 * len(used) * int(group.num_rows))


def _cells(table: pa.Table, name: str, element: tuple[str, int] | None, *, is_clock: bool) -> Floats:
    """(n,) a column's numbers, those of an element of its lists, or seconds of its times."""
    if element is not None:
        column, index = table.column(element[0]), element[1]
        of_text = pa.types.is_string(column.type) or pa.types.is_large_string(column.type)
        try:
            return (elements_of_texts if of_text else elements_of_lists)(column, [index])[index]
        except (DataError, pa.ArrowInvalid, AttributeError) as error:
            raise DataError(f"{element[0]}: {error}") from None
    column = table.column(name)
    if not is_clock:
        return _numbers(column, name)
    if pa.types.is_timestamp(column.type):
        ticks = column.cast(pa.timestamp("ns", column.type.tz)).cast(pa.int64())
        return np.asarray(ticks.to_numpy(zero_copy_only=False), dtype=float) * 1e-9
    return seconds_of_clock(column.cast(pa.string()).to_pylist())


def _is_clock(kind: pa.DataType) -> bool:
    """Whether a column's type is of times."""
    return bool(pa.types.is_timestamp(kind) or pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _numbers(column: pa.ChunkedArray, name: str) -> Floats:
    try:
        return np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        advice = " Its time may be text: unit = 'iso' in a mapping." if _is_clock(column.type) else ""
        raise DataError(f"column {name} holds {column.type}, wanted numbers.{advice}") from None
