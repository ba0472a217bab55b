"""Lines over time from tables of any length: only what a screen can show is sent, from the full data at every zoom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tsdownsample import MinMaxLTTBDownsampler

from diagnosis.models.channels import AXES, KINDS
from studio.work.arrays import read_array
from studio.work.results import FlightInfo, Rows, SegmentInfo

Array = NDArray[Any]
POINTS = 1000  # of a line: one for each pixel of a wide screen's panel, extremes among them
GAP = 0.5  # s without a row, over which no line is drawn


@dataclass(frozen=True, eq=False)
class Line:
    """A line's points, NaN where it is interrupted."""

    x: Array
    y: Array


def thinned(x: Array, y: Array, window: tuple[float, float] | None = None, points: int = POINTS) -> Line:
    """The part of a line (n,) in a window of x, with a point on each side, and at most so many points.

    Extremes survive: minimum and maximum of each part are candidates of the largest triangles (tsdownsample).
    """
    if window is not None:
        first, stop = np.searchsorted(x, window)
        span = slice(max(0, int(first) - 1), int(stop) + 1)
        x, y = x[span], y[span]
    finite = np.isfinite(y)
    x, y = np.ascontiguousarray(x[finite], dtype=float), np.ascontiguousarray(y[finite], dtype=float)
    if len(x) > points:
        rows = MinMaxLTTBDownsampler().downsample(x, y, n_out=points)
        gaps = np.flatnonzero(np.diff(x) > GAP)
        rows = np.unique(np.concatenate([rows, gaps, gaps + 1]).astype(np.intp))
        x, y = x[rows], y[rows]
    breaks = np.flatnonzero(np.diff(x) > max(GAP, 4 * (x[-1] - x[0]) / len(x) if len(x) else GAP)) + 1
    return Line(np.insert(x, breaks, np.nan), np.insert(y, breaks, np.nan).astype(np.float32))


def flight_line(folder: Path, flight: FlightInfo, number: int, column: str, window: Any = None) -> Line:
    """A column of a log's table."""
    names = [c.name for c in flight.columns]
    time, table = read_array(folder, f"time_{number}"), read_array(folder, f"table_{number}")
    return thinned(time, table[names.index(column)], window)


def rows_of_log(rows: Rows, log: int) -> list[SegmentInfo]:
    """The segments of one log in the order of time."""
    return sorted((s for s in rows.segments if s.log == log), key=lambda s: s.start)


def row_numbers(rows: Rows, log: int) -> NDArray[np.intp]:
    """The rows of a log, in the order of time."""
    parts = [np.arange(s.first, s.stop) for s in rows_of_log(rows, log)]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.intp)


def channel_line(folder: Path, rows: Rows, log: int, channel: int, model: str | None, window: Any = None) -> Line:
    """A channel of a log: measured, or predicted by the model whose residuals have that name."""
    numbers = row_numbers(rows, log)
    time, measured = read_array(folder, "time")[numbers], read_array(folder, "measured")[numbers, channel]
    values = measured if model is None else measured - read_array(folder, model)[numbers, channel]
    return thinned(time, values, window)


def over_floor(folder: Path, rows: Rows, model: str, numbers: NDArray[np.intp] | None = None) -> Array:
    """(m, 4) norm of each kind's residual over its floor, NaN where the kind is absent."""
    table = read_array(folder, model)
    values = np.asarray(table if numbers is None else table[numbers], dtype=float)
    floor = np.array(rows.floor).reshape(len(KINDS), AXES)
    levels = np.sqrt(np.sum(floor**2, axis=1))
    norms = np.sqrt(np.sum(values.reshape(len(values), len(KINDS), AXES) ** 2, axis=2))
    return np.asarray(norms / np.where(levels > 0, levels, np.nan))


def worst_windows(
    folder: Path, rows: Rows, model: str, *, seconds: float = 2.0, count: int = 5
) -> list[tuple[SegmentInfo, float, float]]:
    """Segment, start (s in the log's time) and RMS over floor of the worst windows, none two overlapping."""
    level = np.nanmean(over_floor(folder, rows, model) ** 2, axis=1)
    time = read_array(folder, "time")
    length = max(1, round(seconds * rows.rate))
    windows = []
    for segment in rows.segments:
        part = level[segment.first : segment.stop]
        if len(part) < length:
            continue
        means = np.convolve(part, np.ones(length) / length, mode="valid")
        for _ in range(count):
            place = int(np.argmax(means))
            if means[place] <= 0:
                break
            windows.append((segment, float(time[segment.first + place]), float(np.sqrt(means[place]))))
            means[max(0, place - length) : place + length] = 0.0
    return sorted(windows, key=lambda window: -window[2])[:count]


def cell_seconds(folder: Path, rows: Rows, quantity: int, cell: int) -> list[tuple[int, float, float]]:
    """Log, start and stop (s in the log's time) of the spans that lie in a cell of a regime map, longest first."""
    inside = cells_of(folder, rows, quantity) == cell
    time = read_array(folder, "time")
    spans = []
    for segment in rows.segments:
        part = inside[segment.first : segment.stop].astype(int)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], part, [0]])))
        for first, stop in edges.reshape(-1, 2):
            start, end = time[segment.first + first], time[segment.first + stop - 1]
            spans.append((segment.log, float(start), float(end) + 1 / rows.rate))
    return sorted(spans, key=lambda s: s[1] - s[2])


def cells_of(folder: Path, rows: Rows, quantity: int) -> NDArray[np.intp]:
    """(m,) cell of each row in a quantity's map, -1 where it has no value."""
    values, edges = read_array(folder, "quantities")[quantity], np.array(rows.quantities[quantity].edges)
    cells = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    return np.where(np.isfinite(values), cells, -1)


def row_at(folder: Path, rows: Rows, log: int, time: float) -> int | None:
    """The row of a log that is nearest to a time, None where it has none."""
    numbers = row_numbers(rows, log)
    if not len(numbers):
        return None
    return int(numbers[np.argmin(np.abs(read_array(folder, "time")[numbers] - time))])


def window_of(relayout: Any) -> tuple[float, float] | None:
    """The range of time that a zoom left, None for all."""
    for name, value in (relayout or {}).items():
        if name.startswith("xaxis") and name.endswith("range") and isinstance(value, Sequence):
            return float(value[0]), float(value[1])
        if name.startswith("xaxis") and name.endswith("range[0]"):
            return float(value), float(relayout[name.replace("[0]", "[1]")])
    return None


def zoomed(relayout: Any) -> bool:
    """Whether a change of a picture's layout is one of the time that it shows."""
    return any(name.startswith("xaxis") and ("range" in name) for name in relayout or {})
