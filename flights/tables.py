"""Flights as files: the flight CSV and its Parquet twin, both read back bit for bit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet

from dynamics.arrays import Floats
from dynamics.decoding import decode_json
from dynamics.files import write_whole
from dynamics.version import VERSION_KEY, __version__
from flights.log import Origin, Provenance
from flights.quantities import quantity_of

TIME = "t"
ADVICE = "Give a folder that can be written."
_KEY = b"alula.flight"


class Notes(msgspec.Struct, frozen=True):
    """A flight's metadata in a Parquet file."""

    provenance: Provenance
    origins: dict[str, Origin]
    parameters: dict[str, float]
    metadata: dict[str, str]


def write_csv(time: Floats, columns: Mapping[str, Floats], path: Path) -> Path:
    """Write the flight CSV; NaN is an empty cell. Raises RequestError when it cannot be written."""
    arrays = [pa.array(time), *(pa.array(values, from_pandas=True) for values in columns.values())]
    table = pa.table(arrays, names=[TIME, *columns])
    header = (",".join([TIME, *columns]) + "\n").encode()

    def write(file: Path) -> None:
        with file.open("wb") as stream:
            stream.write(header)
            pa_csv.write_csv(table, stream, pa_csv.WriteOptions(include_header=False))

    return write_whole(path, write, advice=ADVICE)


def write_parquet(time: Floats, columns: Mapping[str, Floats], notes: Notes, path: Path) -> Path:
    """Write a Parquet file with units and frames in its schema. Raises RequestError when it cannot be written."""
    fields = [pa.field(TIME, pa.float64(), metadata={"unit": "s"})]
    for name in columns:
        quantity = quantity_of(name)
        details = {} if quantity is None else {"unit": quantity.unit, "frame": quantity.frame}
        fields.append(pa.field(name, pa.float64(), metadata=details))
    schema = pa.schema(fields, metadata={_KEY: msgspec.json.encode(notes), VERSION_KEY: __version__})
    table = pa.table([pa.array(time), *(pa.array(values) for values in columns.values())], schema=schema)
    return write_whole(path, lambda file: pa_parquet.write_table(table, file, compression="zstd"), advice=ADVICE)


def decode_notes(metadata: Mapping[bytes, bytes] | None) -> Notes | None:
    """The notes in a Parquet schema, None for a file of another program."""
    text = (metadata or {}).get(_KEY)
    return None if text is None else decode_json(text, Notes)
