"""Rival streams: of several for one quantity the one that moves is used, and the others are listed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flights.log import Stream, UnusedStream
from flights.movement import moving_columns
from flights.quantities import PRIMARY, ROTORS

_STILL = 0.01  # of the span of the rival that moves furthest, below which a stream stands still
_ROWS = 20_000  # of a stream that are judged
RIVAL = "is taken from"


def settled(streams: Sequence[Stream], unused: Sequence[UnusedStream]) -> tuple[list[Stream], list[tuple[Stream, str]]]:
    """Streams with those that move first, and those that are not used, each with the reason.

    Rotors that stand still while others move are left out of the streams.
    """
    ordered, lost = _of_rotors(streams, unused)
    result: list[Stream] = []
    for name in dict.fromkeys(stream.name for stream in ordered):
        rivals = [stream for stream in ordered if stream.name == name]
        if len(rivals) > 1 and name in PRIMARY:
            spans = [_span(stream) for stream in rivals]
            moving = [span > _STILL * max(spans) for span in spans]
            rivals = [r for r, moves in zip(rivals, moving, strict=True) if moves] + [
                r for r, moves in zip(rivals, moving, strict=True) if not moves
            ]
            still = len(rivals) - sum(moving) if any(moving) else 0
            lost += [
                (rival, f"{name} {RIVAL} {rivals[0].source}{'; this one stands still' if stands else ''}")
                for rival, stands in zip(rivals[1:], _last(len(rivals) - 1, still), strict=True)
            ]
        result += rivals
    return result, lost


def _last(length: int, count: int) -> list[bool]:
    return [index >= length - count for index in range(length)]


def _of_rotors(
    streams: Sequence[Stream], unused: Sequence[UnusedStream]
) -> tuple[list[Stream], list[tuple[Stream, str]]]:
    """Streams without rotors that stand still, where others move."""
    rotors = [stream for stream in streams if stream.name in ROTORS]
    turning = [stream for stream in rotors if moving_columns(_thinned(stream))]
    movers = [stream.source for stream in turning]
    movers += [one.source for one in unused if one.moves and one.quantity in ROTORS]
    if not movers:
        return list(streams), []
    still = [stream for stream in rotors if not any(stream is one for one in turning)]
    others = [stream for stream in streams if not any(stream is one for one in still)]
    return others, [(stream, f"it stands still, while {movers[0]} moves") for stream in still]


def _thinned(stream: Stream) -> np.ndarray:
    return stream.values[:: max(1, len(stream.values) // _ROWS)]


def _span(stream: Stream) -> float:
    """The span of the column that moves furthest, without outliers."""
    spans = []
    for column in _thinned(stream).T:
        finite = column[np.isfinite(column)]
        spans.append(float(np.ptp(np.percentile(finite, [1, 99]))) if len(finite) else 0.0)
    return max(spans, default=0.0)
