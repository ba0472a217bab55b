"""Clocks: stamps in bursts, a time in another unit, and sensors that are stamped by different clocks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dynamics.arrays import Floats
from flights.agreement import correlations
from flights.alignment import resample
from flights.hypotheses.hypothesis import CLEARER, Hypothesis, Streams, rise
from flights.hypotheses.motion import GRID_RATE, MAX_ROWS, Motion
from flights.log import Stream
from flights.quantities import MOTION, ROTORS
from flights.stream_repair import TIME, StreamRepair, evenly
from flights.table_time import FAST, MAX_RATE, MIN_RATE, MIN_RATE_OF_POSITION, UNITS, units_of

_BURST = 0.25  # of the mean period, below which a step belongs to a burst; jitter of a scheduler does not come so close
_BURST_SHARE = 0.3  # of the steps
_MIN_SAMPLES = 100
_GAP = 10.0  # mean periods, beyond which a step is a gap rather than the pause between bursts
_MIN_COVERED = 0.5  # share of a stream's time that has samples
_MIN_CHANGE = 0.05  # rad/s or m/s by which its size varies: less tells no time
_PAIRS = (("attitude", "rate", ("rate", "specific_force")), ("position", "velocity", ("velocity",)))
_REACH = 60.0  # s by which clocks may differ
_MIN_OVERLAP = 10.0  # s that are compared
_CLEAR_SHIFT = 0.08  # s, beyond which no sensor is late in a usable log: as far as the effect time_delay is searched
_FOLLOWS = 0.7  # correlation of the sizes of turning and rates at the right shift,
_CLEARER_FAR = 1.0  # in Fisher's z, by which that at a large shift does: of many one does by chance
_UNIQUE = 0.03  # by which it exceeds that at any other shift further than a second
_SMALL = 0.5  # s, a shift that is likelier than a larger one: a periodic flight fits itself a period later


def bursts(streams: Streams) -> list[Hypothesis]:
    """Streams whose samples were stamped when they were published, several at once."""
    hypotheses = []
    for name in (*MOTION, *ROTORS):
        stream = streams.get(name)
        if stream is None:
            continue
        time = stream.time[np.isfinite(stream.values).any(axis=1)]  # a table of several clocks has rows without it
        if len(time) < _MIN_SAMPLES:
            continue
        steps = np.diff(time)
        mean = float(steps.mean())
        inside = steps[steps < _GAP * mean]
        mean = float(inside.mean()) if len(inside) else mean
        close = inside < _BURST * mean
        if close.mean() < _BURST_SHARE or float(inside.max()) < 2 * mean:
            continue
        restored = evenly(time)
        even, worst = float(np.median(np.diff(restored))), float(np.max(np.abs(restored - time)))
        hypotheses.append(
            Hypothesis(
                "burst_stamps",
                f"{name} is stamped in bursts: {1 / even:.0f} Hz by count, while {close.mean():.0%} of its stamps "
                f"follow within {1e3 * float(np.median(inside[close])):.2g} ms",
                f"up to {1e3 * float(inside.max()):.0f} ms without a sample, then several at once; even stamps differ "
                f"by {1e3 * worst:.0f} ms at most",
                (StreamRepair(name, even=True),),
            )
        )
    return hypotheses


def time_unit(streams: Streams) -> list[Hypothesis]:
    """A time that is not in seconds, by a rate that no flight log has."""
    periods = {name: streams[name].period for name in MOTION if name in streams and np.isfinite(streams[name].period)}
    slowest = {name: 1 / (MIN_RATE if name in FAST else MIN_RATE_OF_POSITION) for name in periods}
    name = min(periods, key=lambda name: periods[name], default="")
    if not name:
        return []
    if any(periods[one] > slowest[one] for one in periods):
        units = [unit for unit in units_of(periods[name]) if unit != "s"]
        if len(units) != 1:
            return []
        text = f"the time is in {units[0]}, not in seconds"
        evidence = f"{name} comes every {periods[name]:.4g}, which are {1e3 * periods[name] * UNITS[units[0]]:.3g} ms"
        return [Hypothesis("time_unit", text, evidence, (StreamRepair(TIME, scale=UNITS[units[0]]),))]
    if periods[name] * MAX_RATE < 1 and not bursts(streams):
        factor = next((1 / size for size in UNITS.values() if units_of(periods[name] / size) == ["s"]), None)
        if factor is None:
            return []
        text = f"the time is too short by a factor of {factor:.0e}"
        evidence = f"{name} comes every {periods[name]:.2g} s, which no sensor does"
        return [Hypothesis("time_unit", text, evidence, (StreamRepair(TIME, scale=factor),))]
    return []


def offsets(streams: Streams) -> list[Hypothesis]:
    """Streams of one motion that are stamped by different clocks, by its size: that is the same in all axes."""
    return [offset for pair in _PAIRS if (offset := _offset(streams, *pair)) is not None]


def _offset(streams: Streams, name: str, other_name: str, late_with: tuple[str, ...]) -> Hypothesis | None:
    if not {name, other_name} <= streams.keys():
        return None
    ours, others = _sizes(streams[name]), _sizes(streams[other_name])
    if ours is None or others is None:
        return None
    (start, one), (begin, other) = ours, others
    shift, follows, without = _best_shift(one, other, round((begin - start) * GRID_RATE))
    late = round(begin - start - shift / GRID_RATE, 3)  # s by which the other's stamps are late
    required = CLEARER if abs(late) <= _SMALL else _CLEARER_FAR
    if follows < _FOLLOWS or rise(follows, without) < required or abs(late) < _CLEAR_SHIFT:
        return None
    return Hypothesis(
        "clock",
        f"the {other_name} is on another clock than the {name}: {abs(late):.2f} s {'late' if late > 0 else 'early'}",
        f"their sizes follow each other by {follows:.2f} at that shift, by {max(without, 0.0):.2f} without",
        tuple(StreamRepair(moved, late=late) for moved in late_with if moved in streams),
    )


def _sizes(stream: Stream) -> tuple[float, Floats] | None:
    """Start, s, and (n, 1) sizes of a stream's motion, on a grid of its own; None for one that moves too little."""
    seconds = min(float(stream.time[-1] - stream.time[0]), MAX_ROWS / GRID_RATE)
    if seconds < _MIN_OVERLAP:
        return None
    time = np.asarray(stream.time[0] + np.arange(int(seconds * GRID_RATE)) / GRID_RATE)
    motion = Motion({stream.name: resample(stream, time)})
    vectors_of: dict[str, Callable[[], Floats]] = {
        "attitude": lambda: motion.turning(motion.values["attitude"]),
        "rate": lambda: motion.rate,
        "position": lambda: motion.moved,
        "velocity": lambda: motion.velocity,
    }
    sizes = np.linalg.norm(vectors_of[stream.name](), axis=1, keepdims=True)
    finite = np.isfinite(sizes[:, 0])
    if finite.mean() < _MIN_COVERED or not float(np.std(sizes[finite])) > _MIN_CHANGE:
        return None
    return float(time[0]), np.where(finite[:, None], sizes, np.median(sizes[finite]))


def _best_shift(one: Floats, other: Floats, declared: int) -> tuple[int, float, float]:
    """Rows by which the other's start lies after one's, the correlation there, and that where the stamps say.

    declared: rows that the stamps say.
    """
    reach = round(_REACH * GRID_RATE)
    overlap = round(_MIN_OVERLAP * GRID_RATE)
    around = declared if -len(other) + overlap < declared < len(one) - overlap else 0
    candidates = range(max(around - reach, -len(other) + overlap), min(around + reach, len(one) - overlap) + 1)
    if not candidates:
        return declared, 0.0, 0.0
    scores = correlations(one - one.mean(), other - other.mean(), np.array(candidates))
    best = int(np.argmax(scores))
    there = int(declared - candidates[0])
    without = float(scores[there]) if 0 <= there < len(scores) else 0.0
    small = np.flatnonzero(np.abs(np.arange(len(scores)) - there) <= _SMALL * GRID_RATE)
    if len(small) and scores[small].max() > scores[best] - _UNIQUE:  # of two that fit as well the smaller one
        best = int(small[np.argmax(scores[small])])
        return candidates[best], float(scores[best]), without
    far = np.abs(np.arange(len(scores)) - best) > GRID_RATE
    if far.any() and scores[far].max() > scores[best] - _UNIQUE:
        return declared, without, without
    return candidates[best], float(scores[best]), without
