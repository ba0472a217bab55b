"""Clocks: stamps in bursts, a time in another unit, and sensors that are stamped by different clocks."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynamics.arrays import Floats
from flights.alignment import resample
from flights.hypotheses.hypothesis import Hypothesis
from flights.hypotheses.motion import GRID_RATE, Motion, span_mean
from flights.log import Stream
from flights.quantities import MOTION, ROTORS
from flights.stream_repair import TIME, StreamRepair, evenly

_SLOWEST = {"rate": 0.9, "attitude": 0.9, "specific_force": 0.9, "position": 3.0, "velocity": 3.0}  # s, of any log
_FASTEST = 1 / 20_000  # s
_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_USUAL = (1 / 20_000, 0.5)  # s between samples of a flight log
_BURST = 0.25  # of the mean period, below which a step belongs to a burst; jitter of a scheduler does not come so close
_BURST_SHARE = 0.3  # of the steps
_MIN_SAMPLES = 100
_GAP = 10.0  # mean periods, beyond which a step is a gap rather than the pause between bursts
_REACH = 60.0  # s by which clocks may differ
_MIN_OVERLAP = 10.0  # s that are compared
_CLEAR_SHIFT = 0.08  # s, beyond which no sensor is late in a usable log: as far as the effect time_delay is searched
_FOLLOWS = 0.7  # correlation of the sizes of turning and rates at the right shift,
_BETTER = 0.15  # and by which it exceeds that without, and
_UNIQUE = 0.03  # that at any other shift further than a second


def bursts(streams: Mapping[str, Stream]) -> list[Hypothesis]:
    """Streams whose samples were stamped when they were published, several at once."""
    found = []
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
        found.append(
            Hypothesis(
                "burst_stamps",
                f"{name} is stamped in bursts: {1 / even:.0f} Hz by count, while {close.mean():.0%} of its stamps "
                f"follow within {1e3 * float(np.median(inside[close])):.2g} ms",
                f"up to {1e3 * float(inside.max()):.0f} ms without a sample, then several at once; even stamps differ "
                f"by {1e3 * worst:.0f} ms at most",
                (StreamRepair(name, even=True),),
            )
        )
    return found


def time_unit(streams: Mapping[str, Stream]) -> list[Hypothesis]:
    """A time that is in no seconds, by a rate that no flight log has."""
    slow = {n: s.period for n, s in streams.items() if n in _SLOWEST and _SLOWEST[n] < s.period < np.inf}
    fast = {n: s.period for n, s in streams.items() if n in _SLOWEST and s.period < _FASTEST}
    if slow:
        name, period = min(slow.items(), key=lambda item: item[1])
        unit = next((u for u, f in _UNITS.items() if _USUAL[0] <= period * f <= _USUAL[1]), None)
        if unit is None:
            return []
        text = f"the time is in {unit}, not in seconds"
        evidence = f"{name} comes every {period:.4g}, which are {1e3 * period * _UNITS[unit]:.3g} ms"
        return [Hypothesis("time_unit", text, evidence, (StreamRepair(TIME, scale=_UNITS[unit]),))]
    if fast and not bursts(streams):
        name, period = max(fast.items(), key=lambda item: item[1])
        unit = next((u for u, f in _UNITS.items() if _USUAL[0] <= period / f <= _USUAL[1]), None)
        if unit is None:
            return []
        text = f"the time is too short by {1 / _UNITS[unit]:.0e}: it was taken for {unit} and is in seconds"
        evidence = f"{name} comes every {period:.2g} s, which no sensor does"
        return [Hypothesis("time_unit", text, evidence, (StreamRepair(TIME, scale=1 / _UNITS[unit]),))]
    return []


def offsets(streams: Mapping[str, Stream]) -> list[Hypothesis]:
    """A pose and a gyro that are stamped by different clocks, by the size of what turns: the same in all axes."""
    if not {"attitude", "rate"} <= streams.keys():
        return []
    turning, rate = _sizes(streams["attitude"]), _sizes(streams["rate"])
    if turning is None or rate is None:
        return []
    (start, one), (begin, other) = turning, rate
    shift, follows, without = _best_shift(one, other, round((begin - start) * GRID_RATE))
    seconds = begin - start - shift / GRID_RATE  # the rates' stamps are late by so much
    if follows < _FOLLOWS or follows - without < _BETTER or abs(seconds) < _CLEAR_SHIFT:
        return []
    late = round(seconds, 3)
    concerned = [name for name in ("rate", "specific_force") if name in streams]
    state = "late" if late > 0 else "early"
    return [
        Hypothesis(
            "clock",
            f"the gyro is on another clock than the attitude: {abs(late):.2f} s {state}",
            f"sizes of rates and turning follow each other by {follows:.2f} at that shift, by {max(without, 0.0):.2f} "
            "without",
            tuple(StreamRepair(name, late=late) for name in concerned),
        )
    ]


def _sizes(stream: Stream) -> tuple[float, Floats] | None:
    """Start, s, and (n,) sizes of the body rates, or of an attitude's turning, on a grid of its own."""
    time = np.arange(stream.time[0], stream.time[-1], 1 / GRID_RATE)
    if len(time) < _MIN_OVERLAP * GRID_RATE:
        return None
    values = resample(stream, time)
    vectors = Motion({}).turning(values) if stream.name == "attitude" else span_mean(span_mean(values))
    sizes = np.linalg.norm(vectors, axis=1)
    finite = np.isfinite(sizes)
    if finite.mean() < 0.5 or not float(np.std(sizes[finite])) > 0.05:  # rad/s: too little motion tells no time
        return None
    return float(time[0]), np.where(finite, sizes, np.median(sizes[finite]))


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
    scores = _correlations(one, other, np.array(candidates))
    best = int(np.argmax(scores))
    there = int(declared - candidates[0])
    without = float(scores[there]) if 0 <= there < len(scores) else 0.0
    far = np.abs(np.arange(len(scores)) - best) > GRID_RATE
    if far.any() and scores[far].max() > scores[best] - _UNIQUE:
        return declared, without, without
    return candidates[best], float(scores[best]), without


def _correlations(one: Floats, other: Floats, shifts: np.ndarray) -> Floats:
    """Correlation of two signals where the other begins so many rows after one; over their overlap."""
    from scipy.signal import correlate

    one, other = one - one.mean(), other - other.mean()
    lags = np.arange(-len(other) + 1, len(one))
    product = correlate(one, other, method="fft")
    power_one = correlate(one**2, np.ones_like(other), method="fft")
    power_other = correlate(np.ones_like(one), other**2, method="fft")
    at = np.searchsorted(lags, shifts)
    size = np.sqrt(np.maximum(power_one[at] * power_other[at], 1e-12))
    return np.asarray(product[at] / size)
