"""Clocks of a bag's topics, told by the time of recording: topics of another clock, and stamps that were set.

A bag has two times of each message: the sender's stamp and when it was recorded. Their difference is the delay of the
transport, some milliseconds, where both are of one clock, and anything else, but constant, where they are not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from flights.assembly import Assembly

Stamps = NDArray[np.int64]  # ns
OTHER_CLOCK, CLOCK_STEP = "other_clock", "clock_step"
_SECOND = 1_000_000_000
_DIFFERENT = 0.5  # s between the delays of two topics, beyond which their clocks differ: no transport takes so long
_STEP = 0.3  # s by which stamps jump against the recording, beyond which the clock was set


@dataclass(frozen=True)
class Clock:
    """How a topic's stamps become those of the bag's clock.

    shift: ns to add.
    rows: (n,) those to keep.
    """

    shift: int
    rows: NDArray[np.bool_]


def clocks_of(stamps: Mapping[str, Stamps], recorded: Mapping[str, Stamps], assembly: Assembly) -> dict[str, Clock]:
    """The clock of each topic, with what was found said in the assembly's repairs.

    stamps, recorded: (n,) of each topic, in the order of recording.
    """
    rows_of = {topic: _unset(topic, stamps[topic], recorded[topic], assembly) for topic in stamps}
    delays = {
        topic: int(np.median((recorded[topic] - stamps[topic])[rows])) for topic, rows in rows_of.items() if rows.any()
    }
    if not delays:
        return {topic: Clock(0, rows) for topic, rows in rows_of.items()}
    nearest = min(delays, key=lambda topic: (abs(delays[topic]), topic))
    clocks = {}
    for topic, rows in rows_of.items():
        late = delays.get(topic, delays[nearest]) - delays[nearest]
        if abs(late) < _DIFFERENT * _SECOND:
            clocks[topic] = Clock(0, rows)
            continue
        apart = (recorded[topic] - stamps[topic])[rows]
        spread = float(np.percentile(apart, 95) - np.percentile(apart, 5)) / _SECOND
        assembly.repair(
            OTHER_CLOCK,
            f"{topic} is stamped by another clock than {nearest}: the recording is {late / _SECOND:.3f} s later than "
            f"its stamps, for 9 of 10 messages within {1e3 * spread:.1f} ms; aligned by the time of recording",
        )
        clocks[topic] = Clock(late, rows)
    return clocks


def _unset(topic: str, stamps: Stamps, recorded: Stamps, assembly: Assembly) -> NDArray[np.bool_]:
    """(n,) the rows before, between or after which the clock was not set: those of the longest time with one offset."""
    rows = np.ones(len(stamps), dtype=bool)
    apart = np.diff(stamps) - np.diff(recorded)
    edges = [0, *(np.flatnonzero(np.abs(apart) > _STEP * _SECOND) + 1).tolist(), len(stamps)]
    if len(edges) == 2:
        return rows
    parts = list(pairwise(edges))
    offsets = [float(np.median((stamps - recorded)[start:stop])) / _SECOND for start, stop in parts]
    longest = offsets[int(np.argmax([stop - start for start, stop in parts]))]
    for (start, stop), offset in zip(parts, offsets, strict=True):
        if abs(offset - longest) <= _STEP:
            continue
        rows[start:stop] = False
        lasted = float(recorded[stop - 1] - recorded[start]) / _SECOND
        direction = "back" if offset < longest else "ahead"
        assembly.repair(
            CLOCK_STEP,
            f"{topic}: stamps are {abs(offset - longest):.3f} s {direction} for {lasted:.1f} s ({stop - start} "
            "messages), beside those of its longest time with one clock; these are left out",
        )
    return rows
