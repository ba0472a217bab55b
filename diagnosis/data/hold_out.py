"""Blocks of flight that are held out: spread over it, and moving as the rest does.

What moves differently judges nothing: an effect that only yaw spins show is neither confirmed nor refuted by a line.
Filters begin anew in each part, and leave out its ends, so that nothing of a held-out block is in what is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.thresholds import DatasetThresholds
from dynamics.arrays import Floats
from dynamics.state import POSITION, RATE, VELOCITY

MOTION = ("horizontal speed", "vertical speed", "roll and pitch rate", "yaw rate", "thrust", "moment")


@dataclass(frozen=True)
class Block:
    """Rows from start to before stop of a segment of a flight, both by number."""

    flight: int
    segment: int
    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start


def missing_motion(fitted: Sequence[Segment], held_out: Sequence[Segment], thresholds: DatasetThresholds) -> list[str]:
    """Kinds of motion that held-out segments lack although the fitted ones have them."""
    excited, judged = (_mean_energies(part) for part in (fitted, held_out))
    enough = judged >= thresholds.min_excitation**2 * excited
    return [name for name, there in zip(MOTION, enough, strict=True) if not there]


def held_out_blocks(
    flights: Sequence[Sequence[Segment]], thresholds: DatasetThresholds, min_duration: float
) -> list[Block]:
    """Blocks of about the held-out share of all flights, whose motion, place and time are the most like the rest's.

    One by one, the block is taken that brings what is held out closest to the mean. What remains on either side of it
    is long enough to be fitted, or nothing. min_duration: of a segment, s.
    """
    blocks = _blocks(flights, thresholds, min_duration)
    shares = _shares(flights, blocks, thresholds.boundary)
    duration = np.array([len(b) / flights[b.flight][b.segment].rate for b in blocks])
    required = thresholds.held_out_share * sum(s.duration for parts in flights for s in parts)
    chosen: list[int] = []
    while True:
        free = [
            i for i in range(len(blocks)) if i not in chosen and _leaves_enough(blocks, chosen, i, flights, thresholds)
        ]
        left = required - float(duration[chosen].sum())
        if not free or left < 0.5 * float(np.min(duration[free])):
            return sorted((blocks[i] for i in chosen), key=lambda b: (b.flight, b.segment, b.start))
        chosen.append(min(free, key=lambda i: _imbalance(shares, duration, [*chosen, i])))


def divided(
    flights: Sequence[Sequence[Segment]], blocks: Sequence[Block], min_duration: float
) -> tuple[list[list[Segment]], list[Segment]]:
    """Remaining segments of each flight, and the blocks. min_duration: of a remaining segment, s."""
    fitted, held_out = [], []
    for number, parts in enumerate(flights):
        rest = []
        for place, segment in enumerate(parts):
            own = [b for b in blocks if (b.flight, b.segment) == (number, place)]
            edges = [0, *(edge for b in own for edge in (b.start, b.stop)), len(segment)]
            rest += [segment.between(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a]
            held_out += [segment.between(b.start, b.stop) for b in own]
        fitted.append([part for part in rest if part.duration >= min_duration])
    return fitted, held_out


def _blocks(flights: Sequence[Sequence[Segment]], thresholds: DatasetThresholds, min_duration: float) -> list[Block]:
    """All segments in blocks of equal length; of short ones both ends, or the whole where neither leaves enough."""
    total = sum(s.duration for parts in flights for s in parts)
    duration = max(min_duration, min(thresholds.block, thresholds.held_out_share * total))
    blocks = []
    for number, parts in enumerate(flights):
        for place, segment in enumerate(parts):
            count, end = int(segment.duration / duration), min(duration, segment.duration - thresholds.min_part)
            edges = np.linspace(0, len(segment), max(1, count) + 1).round().astype(int).tolist()
            ranges = list(pairwise(edges))
            if count <= 2 and end >= min_duration:
                rows = int(end * segment.rate)
                ranges = [(0, rows), (len(segment) - rows, len(segment))]
            blocks += [Block(number, place, a, b) for a, b in ranges]
    return blocks


def _leaves_enough(
    blocks: Sequence[Block],
    chosen: Sequence[int],
    new: int,
    flights: Sequence[Sequence[Segment]],
    thresholds: DatasetThresholds,
) -> bool:
    """Whether what remains of a segment around a new block is long enough, or nothing; some segment must remain."""
    block = blocks[new]
    segment = flights[block.flight][block.segment]
    same = [blocks[i] for i in (*chosen, new) if (blocks[i].flight, blocks[i].segment) == (block.flight, block.segment)]
    edges = sorted(edge for b in same for edge in (b.start, b.stop))
    remaining = (np.diff([0, *edges, len(segment)])[::2] + 1) / segment.rate
    entire = len(same) == 1 and len(block) == len(segment)
    alone = sum(map(len, flights)) == 1
    return bool(np.all((remaining <= 1 / segment.rate) | (remaining >= thresholds.min_part))) and not (entire and alone)


def _shares(flights: Sequence[Sequence[Segment]], blocks: Sequence[Block], boundary: float) -> Floats:
    """(blocks, k) share that each block has of all energy of motion, time near each side of the box, and time."""
    everything = [s for parts in flights for s in parts]
    positions = np.vstack([s.smooth[:, POSITION] for s in everything])
    low, high = positions.min(axis=0), positions.max(axis=0)
    rows = []
    for block in blocks:
        part = flights[block.flight][block.segment]
        here = slice(block.start, block.stop)
        motion = _energies(part)[here].sum(axis=0) / part.rate
        place = _near_sides(part.smooth[here, POSITION], low, high, boundary).sum(axis=0) / part.rate
        rows.append(np.concatenate([motion, place, _quarter(flights, block) * len(block) / part.rate]))
    sums = np.array(rows)
    total = sums.sum(axis=0)
    return np.asarray(sums[:, total > 0] / total[total > 0])


def _imbalance(shares: Floats, duration: Floats, chosen: Sequence[int]) -> float:
    """Mean squared relative difference of the shares that are held out from the share of the time."""
    of_time = float(duration[chosen].sum() / duration.sum())
    return float(np.mean((shares[chosen].sum(axis=0) / of_time - 1) ** 2))


def _quarter(flights: Sequence[Sequence[Segment]], block: Block) -> Floats:
    """(4,) 1 for the quarter of its flight's time in which a block lies."""
    before = sum(len(s) for s in flights[block.flight][: block.segment])
    middle = (before + (block.start + block.stop) / 2) / sum(map(len, flights[block.flight]))
    return np.asarray(np.eye(4)[min(3, int(4 * middle))])


def _near_sides(position: Floats, low: Floats, high: Floats, boundary: float) -> Floats:
    """(n, 5) 1 where the vehicle is close to one of four sides or the bottom of the flights' box."""
    extent = boundary * (high - low)
    near = np.hstack([position < low + extent, position[:, :2] > (high - extent)[:2]])
    return near.astype(float)


def _mean_energies(parts: Sequence[Segment]) -> Floats:
    return np.asarray(np.vstack([_energies(s) for s in parts]).mean(axis=0))


def _energies(segment: Segment) -> Floats:
    """(n, 6) squares of the kinds of motion; of forces and moments over their values in hover."""
    velocity, rate = segment.smooth[:, VELOCITY], segment.smooth[:, RATE]
    squares = segment.rotor_speed**2
    squares = squares / squares.mean()
    collective = squares.mean(axis=1)
    moment = squares - collective[:, None]
    return np.column_stack(
        [
            np.sum(velocity[:, :2] ** 2, axis=1),
            velocity[:, 2] ** 2,
            np.sum(rate[:, :2] ** 2, axis=1),
            rate[:, 2] ** 2,
            (collective - collective.mean()) ** 2,
            np.sum((moment - moment.mean(axis=0)) ** 2, axis=1),
        ]
    )
