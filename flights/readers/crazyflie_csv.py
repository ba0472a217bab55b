"""CSV files of Crazyflie's log variables, as the client writes a block's: a time stamp, and group.name columns.

Variables mean what they mean on the micro-SD card (`crazyflie`); a block holds a few of them, so that a flight is
often several files (`--one-flight`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynamics.arrays import Floats
from flights.assembly import Assembly
from flights.log import LogContent
from flights.readers import csv
from flights.readers.crazyflie import STREAMS, VARIABLES, add_variables
from flights.readers.table_head import TableHead, table_head
from flights.readers.unused_variables import variables_to_read
from flights.source import Source
from flights.table_time import Cut, TimeColumns, is_text, unit_by_rate

_TIMES = ("timestamp", "time", "t", "tick", "time_ms", "timestamp_ms")
_MIN_VARIABLES = 2
_USUAL_UNIT = "ms"  # of the client's and the library's stamps


def _time_of(head: TableHead) -> str | None:
    return next((name for name in head.names if name.lower().replace(" ", "_") in _TIMES), None)


def matches(source: Source) -> bool:
    """Whether it is a table with a time and several of Crazyflie's log variables."""
    head = table_head(source)
    return (
        head is not None
        and _time_of(head) is not None
        and len(VARIABLES & set(head.names)) >= _MIN_VARIABLES
        and len(set(head.names)) == len(head.names)
    )


def read(source: Source) -> LogContent:
    """The streams of a block of log variables. Raises DataError for one that cannot be read as a table."""
    head = table_head(source)
    column = None if head is None else _time_of(head)
    if head is None or column is None:
        return Assembly().finish()
    assembly = Assembly()
    time = _time(head, column, assembly)
    clocks = frozenset({column}) if time.is_text else frozenset[str]()
    cut = None if source.span is None else Cut(source.span, time)
    layout = csv.Layout(head.names, head.delimiter, head.decimal, head.lines, clocks, cut)
    used = [name for name in head.names if name in VARIABLES]

    def numbers(names: Sequence[str]) -> dict[str, Floats]:
        return csv.read_columns(source.file, layout, list(names), assembly)

    further = variables_to_read(head.names, {column, *used})
    columns = csv.readable_columns(numbers, [column, *used], {}, assembly, further)
    origin = time.origin(columns) or 0.0
    assembly.origin = origin * time.unit
    if len(columns[column]):
        add_variables(
            assembly, time.seconds(columns, origin), {name: columns[name] for name in columns if name != column}
        )
    if not {"position", "rate"} <= {name for name, variables, _ in STREAMS if set(variables) <= set(used)}:
        assembly.note("a block of log variables; further blocks of the flight join it by --one-flight")
    others = [name for name in head.names if name not in used and name not in (column, "")]
    if others:
        assembly.note(f"columns that are none of a flight's quantities: {', '.join(others[:12])}")
    if source.span is None:  # a span of it would choose otherwise than the next one
        assembly.settle_rivals()
    return assembly.finish()


def _time(head: TableHead, column: str, assembly: Assembly) -> TimeColumns:
    """The time: milliseconds, as the firmware stamps a block, unless its rate is none of a flight's then."""
    if is_text(head.cells(column)):
        return TimeColumns(column, is_text=True)
    stamps = head.numbers(column)
    steps = np.abs(np.diff(stamps[np.isfinite(stamps)]))
    period = float(np.median(steps[steps > 0])) if (steps > 0).any() else 10.0
    if 0.8 <= period <= 1000.0:
        return TimeColumns(column, 1e-3)
    unit, name = unit_by_rate(stamps, column, ("rate_x",))
    assembly.note(f"{column} is in {name} by its rate of rows, and not in {_USUAL_UNIT} as the client's is")
    return replace(TimeColumns(column), unit=unit)
