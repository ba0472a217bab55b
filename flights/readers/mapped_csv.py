"""Tables of other tools, text or Parquet, by a column mapping: a TOML file that names columns, units, frames and time.

The mappings in flights/mappings/ are applied without being named when all of their columns are in the table.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from flights import mapping as mappings
from flights import pose_source
from flights.assembly import Assembly
from flights.cells import element_of
from flights.log import LogContent
from flights.mapping import MappedStream, Mapping
from flights.quantities import PRIMARY
from flights.readers import csv, parquet
from flights.readers.unnamed_columns import columns_of, keep_unnamed, unnamed_columns
from flights.source import Source
from flights.table_time import Cut

_MAX_LINE = 60_000


def header_of(source: Source, mapping: Mapping | None = None) -> tuple[str, ...]:
    """The names of a table's columns, empty for any other file. Raises DataError for a torn Parquet file."""
    if parquet.matches(source):
        return parquet.names_of(source)
    line = source.first_line()
    if mapping is not None:
        line = re.sub(mapping.file.prefix, "", line, count=1) if mapping.file.prefix else line
        delimiter = mapping.file.delimiter
    else:
        delimiter = max(",;\t", key=line.count)
    names = tuple(name.strip().strip('"') for name in line.split(delimiter))
    return names if len(names) > 1 and len(line) < _MAX_LINE else ()


def has_columns(source: Source, mapping: Mapping) -> bool:
    """Whether a file is a table with any of a mapping's columns."""
    try:
        names = header_of(source, mapping)
    except (DataError, RequestError):
        return False
    return any(column in names or element_of(column, names) is not None for column in mapping.columns)


def matches(source: Source) -> bool:
    """Whether the file has all columns of one of the shipped mappings."""
    try:
        return not source.is_folder and _shipped_for(source) is not None
    except DataError:  # a torn table, of which its own format's reader says so
        return False


def read(source: Source) -> LogContent:
    """The streams of a table by its mapping. Raises RequestError when mapping and table do not fit."""
    mapping = _shipped_for(source) if source.mapping is None else mappings.read_mapping(source.mapping)
    if mapping is None:
        raise RequestError("no mapping fits these columns.")
    names = header_of(source, mapping)
    missing = [column for column in mapping.columns if column not in names and element_of(column, names) is None]
    if missing:
        raise RequestError(
            f"the mapping {mapping.name!r} needs the columns {', '.join(missing)}, which are not among "
            f"{', '.join(names) or '(no columns: is it text or Parquet?)'}. Correct the mapping."
        )
    assembly = Assembly()
    assembly.metadata["mapping"] = mapping.name
    if mapping.pose:
        assembly.metadata[pose_source.KEY] = mapping.pose
    assembly.note(f"columns by the mapping {mapping.name!r}")
    unnamed = unnamed_columns(names, mapping.columns)
    columns = _columns(source, names, mapping, assembly, columns_of(unnamed))
    clock = mapping.time.columns
    origin = clock.origin(columns) or 0.0 if mapping.time.from_first_row else 0.0
    time = clock.seconds(columns, origin)
    assembly.origin = origin * clock.unit
    for stream in mapping.streams:
        if not columns.keys() >= set(stream.columns):
            continue
        values = np.stack([columns[column] for column in stream.columns], axis=1)
        assembly.add(stream.quantity, time, _converted(values, stream, mapping), ", ".join(stream.columns))
    keep_unnamed(assembly, unnamed, columns)
    return assembly.finish()


def _shipped_for(source: Source) -> Mapping | None:
    for mapping in mappings.shipped():
        names = header_of(source, mapping)
        if all(column in names or element_of(column, names) is not None for column in mapping.columns):
            return mapping
    return None


def _columns(
    source: Source, names: tuple[str, ...], mapping: Mapping, assembly: Assembly, unnamed: Sequence[str]
) -> dict[str, Floats]:
    needed = {name for stream in mapping.streams if stream.quantity in PRIMARY for name in stream.columns}
    clock = mapping.time.columns
    primary = [*clock.names, *(name for name in dict.fromkeys(mapping.columns) if name in needed)]
    secondary: dict[str, list[str]] = {}
    for stream in mapping.streams:
        if stream.quantity not in PRIMARY:
            own = secondary.setdefault(stream.quantity, [])
            own.extend(name for name in stream.columns if name not in {*primary, *own})
    cut = None if source.span is None else Cut(source.span, clock)
    prefix = re.compile(mapping.file.prefix.encode()) if mapping.file.prefix else None
    clocks = frozenset({clock.column}) if clock.is_text else frozenset[str]()
    file = mapping.file
    layout = csv.Layout(names, file.delimiter, file.decimal, clocks=clocks, cut=cut, prefix=prefix)
    is_parquet = parquet.matches(source)

    def numbers(used: Sequence[str]) -> dict[str, Floats]:
        used = list(dict.fromkeys(used))  # two quantities may be of one column
        if is_parquet:
            return parquet.read_columns(source, used, cut, clocks)
        return csv.read_columns(source.file, layout, used, assembly)

    return csv.readable_columns(numbers, primary, secondary, assembly, unnamed)


def _converted(values: Floats, stream: MappedStream, mapping: Mapping) -> Floats:
    """Values in our units, order and frames."""
    values = (values - np.asarray(stream.offset)) * (np.asarray(stream.scale) / stream.pole_pairs)
    if stream.range is not None:
        low, high = stream.range
        values = (values - low) / (high - low)
    elif stream.unit:
        values = values * mappings.UNITS[stream.unit]
    if stream.quantity in ("attitude", "attitude_setpoint"):
        return _attitude(values, stream, mapping)
    frame = stream.frame or _default_frame(stream, mapping)
    if frame == "NED":
        return frames.enu_from_ned(values)
    if frame == "FRD":
        return frames.flu_from_frd(values)
    return values


def _attitude(values: Floats, stream: MappedStream, mapping: Mapping) -> Floats:
    if stream.order == "euler":
        attitude = quaternion.from_euler(values[:, 0], values[:, 1], values[:, 2])
    elif stream.order == "xyzw":
        attitude = frames.quaternion_from_xyzw(values)
    elif stream.order == "xyz":
        attitude = quaternion_of_vector_part(values)
    else:
        attitude = values
    if mapping.frames.world == "NED":
        attitude = frames.attitude_to_enu(attitude)
    return frames.attitude_of_flu(attitude) if mapping.frames.body == "FRD" else np.asarray(attitude)


def quaternion_of_vector_part(vector: Floats) -> Floats:
    """(n, 4) quaternions of unit length, w first, of their parts x, y and z (n, 3), of which w is not negative."""
    rest = 1.0 - np.sum(vector**2, axis=1, keepdims=True)
    return np.hstack([np.sqrt(np.maximum(rest, 0.0)), vector])


def _default_frame(stream: MappedStream, mapping: Mapping) -> str:
    """The frame of a vector by the mapping's frames of world and body."""
    return {"world ENU": mapping.frames.world, "body FLU": mapping.frames.body}.get(stream.frame_of_quantity, "")
