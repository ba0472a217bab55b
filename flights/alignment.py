"""From streams on their own clocks to one uniform table: the only place where streams are joined.

Never on equal stamps: every stream is resampled onto the common clock by itself, and where it has a gap its columns
are NaN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from dynamics.errors import DataError
from flights import filters
from flights.log import Log, Origin, Stream, spanning_streams

GAP_PERIODS = 5.0  # times a stream's own period without a sample are a gap,
MIN_GAP = 0.02  # s, but never less than this
JITTER = 1e-3  # of the period, up to which equal clocks count as uniform and are left as they are
MAX_RATE = 2000.0  # Hz
THINNING = 0.8  # of a stream's rate, below which a common clock would fold its noise back
ROUNDING = 1e-9  # s of rounding between a common clock and a stream's stamps
MAX_ROWS = 10_000_000  # 11 h at 250 Hz; more is read in chunks


@dataclass(frozen=True, eq=False)
class AlignedTable:
    """Streams on one uniform clock.

    time: (n,) s.
    values: (n, k) by quantity, NaN in gaps.
    origins: by quantity.
    """

    time: Floats
    values: Mapping[str, Floats]
    origins: Mapping[str, Origin]


def align(log: Log, *, rate: float | None = None) -> AlignedTable:
    """The log's streams, the first of each quantity, on one uniform clock.

    rate: Hz; by default that of the body rates, or else of the fastest stream of motion. The table spans the streams
    of motion and rotors, or all there is when there are none.

    Raises DataError when there is nothing to align.
    """
    streams = [stream for name in log.names if (stream := log.stream(name)) is not None]
    if not streams:
        raise DataError(f"{log.provenance.path}: no flight data in it. " + " ".join(log.provenance.notes))
    time = _common_clock(streams, rate)
    values = {
        stream.name: stream.values if np.array_equal(stream.time, time) else resample(_thinned(stream, time), time)
        for stream in streams
    }
    origins = {s.name: Origin(s.source, round(s.rate, 3), len(s.time)) for s in streams}
    return AlignedTable(time, values, origins)


def _common_clock(streams: list[Stream], rate: float | None) -> Floats:
    """The uniform clock; the streams' own when they already share a uniform one."""
    shared = streams[0].time
    if rate is None and is_uniform(shared) and all(np.array_equal(s.time, shared) for s in streams):
        return shared
    spanning = spanning_streams(streams)
    start = min(float(s.time[0]) for s in spanning)
    end = max(float(s.time[-1]) for s in spanning)
    chosen = rate if rate is not None else _natural_rate(spanning)
    gyro = next((stream for stream in spanning if stream.name == "rate"), None)
    if gyro is not None:  # its samples shall need no interpolation
        start = float(gyro.time[0]) - np.floor((float(gyro.time[0]) - start) * chosen + 1e-6) / chosen
    count = int(np.floor((end - start) * chosen + 1e-6)) + 1
    if count > MAX_ROWS:
        raise DataError(
            f"{end - start:.0f} s at {chosen:g} Hz are {count} rows. Check the time's unit, cut the log into "
            "shorter ones, or give a lower rate."
        )
    return np.asarray(start + np.arange(count) / chosen)


def _natural_rate(streams: list[Stream]) -> float:
    """The rate of the gyro, or of the fastest stream: whole hertz, so that its period is a short decimal."""
    named = {stream.name: stream.rate for stream in streams}
    fastest = named.get("rate") or max(named.values())
    return float(min(max(round(fastest), 1), MAX_RATE))


def is_uniform(time: Floats) -> bool:
    """Whether stamps are equally spaced but for rounding. time: (n,) s."""
    if len(time) < 3:
        return True
    steps = np.diff(time)
    period = float(np.median(steps))
    return bool(np.max(np.abs(steps - period)) <= JITTER * period + 1e-9)


def resample(stream: Stream, time: Floats) -> Floats:
    """A stream's values at other times, (m, k); NaN in its gaps and beyond its ends.

    time: (m,) s, increasing.
    """
    if stream.quantity.kind == "step":
        return _held(stream, time)
    finite = np.isfinite(stream.values)
    if stream.quantity.kind == "linear" and (finite.any(axis=1) != finite.all(axis=1)).any():
        # a height may be finite where a horizontal position is not: each column by itself
        return np.concatenate([_between(stream, column[:, None], time) for column in stream.values.T], axis=1)
    return _between(stream, stream.values, time)


def _between(stream: Stream, values: Floats, time: Floats) -> Floats:
    """Values (n, k) of a stream at other times, interpolated between complete rows."""
    complete = np.flatnonzero(np.isfinite(values).all(axis=1))
    if not len(complete):
        return np.full((len(time), values.shape[1]), np.nan)
    stamps, values = stream.time[complete], values[complete]
    if len(stamps) == 1:
        hit = time == stamps[0]
        return np.where(hit[:, None], values[0], np.nan)
    right = np.clip(np.searchsorted(stamps, time, side="right"), 1, len(stamps) - 1)
    left = right - 1
    span = stamps[right] - stamps[left]
    share = (time - stamps[left]) / span
    result = values[left] + share[:, None] * (values[right] - values[left])
    exact = share == 0
    result[exact] = values[left[exact]]
    if stream.quantity.kind == "attitude":
        result = _on_sphere(result, exact)
    limit = max(GAP_PERIODS * stream.period, MIN_GAP)
    result[_outside(share) | ((span > limit) & (share > 0) & (share < 1))] = np.nan
    return result


def _outside(share: Floats) -> NDArray[np.bool_]:
    # a common clock may end a rounding error past the last sample
    return np.asarray((share < -1e-6) | (share > 1 + 1e-6))


def _on_sphere(attitude: Floats, untouched: NDArray[np.bool_]) -> Floats:
    length = np.linalg.norm(attitude, axis=1, keepdims=True)
    unit = np.where(length > 1e-9, attitude / np.maximum(length, 1e-9), np.nan)
    return np.where(untouched[:, None], attitude, unit)


def _thinned(stream: Stream, time: Floats) -> Stream:
    """The stream without frequencies that a slower clock would alias: a zero-phase low-pass.

    It looks ahead by about two periods of the slower clock. Step quantities and slower streams are returned as they
    are.
    """
    if len(time) < 2 or len(stream.time) < 3 or stream.quantity.kind == "step":
        return stream
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if rate > THINNING * stream.rate:
        return stream
    count = int(np.floor((stream.time[-1] - stream.time[0]) * stream.rate + 1e-6)) + 1
    even = np.asarray(stream.time[0] + np.arange(count) * stream.period)
    smooth = filters.anti_aliased(resample(stream, even), stream.rate, rate)
    return Stream(stream.name, even, smooth, stream.source)


def _held(stream: Stream, time: Floats) -> Floats:
    """The last value at or before each time; NaN before the first."""
    at = np.searchsorted(stream.time, time + ROUNDING, side="right") - 1
    held = stream.values[np.maximum(at, 0)]
    return np.where((at < 0)[:, None], np.nan, held)
