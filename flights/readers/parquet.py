"""Parquet files with the columns of the flight CSV, ours or anybody's."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pa_parquet

from dynamics.errors import DataError
from flights.assembly import Assembly
from flights.log import Floats, Reading
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
            table = file.read(columns=wanted)
            notes = decode_notes(file.schema_arrow.metadata)
    except (pa.ArrowInvalid, OSError) as error:
        raise DataError(f"this Parquet file is torn or damaged: {error}. Wanted a whole one; write it again.") from None
    columns = {name: _numbers(table.column(name), name) for name in wanted}
    if source.span is not None:
        kept = csv.Cut(source.span, TIME).mask(columns)
        columns = {name: values[kept] for name, values in columns.items()}
    if len(columns[TIME]):
        csv.add_table(assembly, columns, names)
    if notes is not None:
        assembly.metadata |= notes.metadata
        assembly.parameters |= notes.parameters
        assembly.note(f"made from {notes.provenance.path} ({notes.provenance.format}, {notes.provenance.sha256[:12]})")
        for repair in notes.provenance.repairs:
            assembly.note(f"repaired when it was made: {repair}")
    return assembly.finish(keep_time=True)


def _numbers(column: pa.ChunkedArray, name: str) -> Floats:
    try:
        return np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=float)
    except pa.ArrowInvalid:
        raise DataError(f"column {name} holds {column.type}, wanted numbers.") from None
