"""Parquet files with the columns of the flight CSV, ours or anybody's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet

from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.unpacking import Unpacking
from flights.assembly import Assembly
from flights.log import LogContent
from flights.quantities import quantity_of
from flights.readers import csv
from flights.readers.unnamed_columns import columns_of, keep_unnamed, unnamed_columns
from flights.source import Source
from flights.tables import TIME, decode_notes

BATCH_ROWS = 1 << 16  # that are unpacked at once


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
    cut = None if source.span is None else csv.Cut(source.span, TIME)
    unnamed = unnamed_columns(names, used)
    primary, secondary = csv.needed_columns(names)
    columns = csv.readable_columns(
        lambda some: read_columns(source, some, cut), primary, secondary, assembly, columns_of(unnamed)
    )
    with _opened(source) as file:
        notes = decode_notes(file.schema_arrow.metadata)
    if len(columns[TIME]):
        csv.add_table(assembly, columns, names)
        keep_unnamed(assembly, unnamed, columns)
    if notes is not None:
        assembly.metadata |= notes.metadata
        assembly.parameters |= notes.parameters
        assembly.note(f"made from {notes.provenance.path} ({notes.provenance.format}, {notes.provenance.sha256[:12]})")
        for repair in notes.provenance.repairs:
            assembly.note(f"repaired when it was made: {repair}")
    return assembly.finish(keep_time=True)


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


def read_columns(source: Source, used: Sequence[str], cut: csv.Cut | None) -> dict[str, Floats]:
    """Columns as numbers, all rows or those that a cut selects. Raises DataError for a torn file and for no numbers."""
    with _opened(source) as file:
        return _columns(file, source, used, cut)


def _columns(
    file: pa_parquet.ParquetFile, source: Source, used: Sequence[str], cut: csv.Cut | None
) -> dict[str, Floats]:
    """The used columns, all rows or those of a span, for which only the row groups of the span are read."""
    if cut is None:
        table = _within_limits(file, source, used, range(file.num_row_groups))
        return {name: _numbers(table.column(name), name) for name in used}
    parts: dict[str, list[Floats]] = {name: [] for name in used}
    for group in range(cut.span.place or 0, file.num_row_groups):
        cut.begin(group)
        table = _within_limits(file, source, used, [group])
        block = {name: _numbers(table.column(name), name) for name in used}
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
    pages = sum(column.total_uncompressed_size for column in columns if column.path_in_schema in used)
    return max(int(pages), 8 * len(used) * int(group.num_rows))


def _numbers(column: pa.ChunkedArray, name: str) -> Floats:
    try:
        return np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
    except pa.ArrowInvalid:
        raise DataError(f"column {name} holds {column.type}, wanted numbers.") from None
