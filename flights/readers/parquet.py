"""Parquet files with the columns of the flight CSV, ours or anybody's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet

from dynamics.arrays import Floats
from dynamics.errors import DataError
from flights.assembly import Assembly
from flights.log import Reading
from flights.quantities import quantity_of
from flights.readers import csv
from flights.source import Source
from flights.tables import TIME, decode_notes


def matches(source: Source) -> bool:
    """Whether it begins as a Parquet file does."""
    return source.head.startswith(b"PAR1")


def read(source: Source) -> Reading:
    """The streams of a Parquet file. Raises DataError for a torn one or one without the columns of a flight."""
    assembly = Assembly()
    try:
        with pa_parquet.ParquetFile(source.file) as file:
            names = file.schema_arrow.names
            wanted = [name for name in names if name == TIME or quantity_of(name) is not None]
            if TIME not in wanted or len(wanted) < 2:
                raise DataError(
                    f"this Parquet file has the columns {', '.join(names[:12])}; wanted {TIME} and columns of the "
                    "flight CSV, as position_x. Rename them."
                )
            columns = _columns(file, wanted, None if source.span is None else csv.Cut(source.span, TIME))
            notes = decode_notes(file.schema_arrow.metadata)
    except (pa.ArrowInvalid, OSError) as error:
        raise DataError(f"this Parquet file is torn or damaged: {error}. Wanted a whole one; write it again.") from None
    if len(columns[TIME]):
        csv.add_table(assembly, columns, names)
    if notes is not None:
        assembly.metadata |= notes.metadata
        assembly.parameters |= notes.parameters
        assembly.note(f"made from {notes.provenance.path} ({notes.provenance.format}, {notes.provenance.sha256[:12]})")
        for repair in notes.provenance.repairs:
            assembly.note(f"repaired when it was made: {repair}")
    return assembly.finish(keep_time=True)


def _columns(file: pa_parquet.ParquetFile, wanted: Sequence[str], cut: csv.Cut | None) -> dict[str, Floats]:
    """The wanted columns, all rows or those of a span, of which no more row groups are read than it needs."""
    if cut is None:
        table = file.read(columns=list(wanted))
        return {name: _numbers(table.column(name), name) for name in wanted}
    parts: dict[str, list[Floats]] = {name: [] for name in wanted}
    for group in range(cut.span.place or 0, file.num_row_groups):
        cut.begin(group)
        table = file.read_row_group(group, columns=list(wanted))
        block = {name: _numbers(table.column(name), name) for name in wanted}
        kept = cut.mask(block)
        for name, values in block.items():
            parts[name].append(values[kept])
        if cut.is_over:
            break
    return {name: np.concatenate(blocks or [np.empty(0)]) for name, blocks in parts.items()}


def _numbers(column: pa.ChunkedArray, name: str) -> Floats:
    try:
        return np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
    except pa.ArrowInvalid:
        raise DataError(f"column {name} holds {column.type}, wanted numbers.") from None
