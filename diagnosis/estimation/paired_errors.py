"""Two models on the same rows: by how much an error changes, and whether by more than chance.

Errors are correlated in time, so that rows are summed over blocks first. Differences of squared errors count, since
what else is missing, such as a gust, adds to both and cancels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.models import channels
from diagnosis.models.open_loop import OPEN_LOOP_QUANTITIES
from diagnosis.thresholds import DEFAULT, RelevanceThresholds
from dynamics.arrays import Floats


@dataclass(frozen=True)
class ErrorChange:
    """Change of an RMS error from one model to another.

    before, after: RMS over the axes.
    floor: with which it is compared, likewise.
    by_axis: change of the mean squared error of each axis, over its squared floor.
    deviations: the mean of these over its standard deviation, positive where it rises.
    motion: RMS of what is predicted in open loop, the unit of its errors' rises; 0 for channels, whose floor is theirs.
    """

    before: float
    after: float
    floor: float
    by_axis: tuple[float, ...]
    deviations: float
    motion: float = 0.0

    @property
    def rise(self) -> float:
        """How much an error at the floor would change, over the floor; negative where it falls. Axes count alike.

        In open loop, how much the error changes, over the motion.
        """
        if self.motion > 0:
            return (self.after - self.before) / self.motion
        return relative_rise(float(np.mean(self.by_axis)))

    def is_worse(self, limits: RelevanceThresholds = DEFAULT.relevance) -> bool:
        """Whether the error rises by more than chance, and enough to matter."""
        largest = limits.max_open_loop_rise if self.motion > 0 else limits.max_rise
        return self.rise > largest and self.deviations > limits.deviations


@dataclass(frozen=True, eq=False)
class ModelErrors:
    """Residuals of one model.

    rows: (m, 12) of each segment. of_inputs: (m, 12) of each that errors of measured states make, for each of some
    draws of these, the same for all models.
    """

    rows: Sequence[Floats]
    of_inputs: Sequence[Sequence[Floats]] = ()

    def squares(self, axes: slice) -> list[Floats]:
        """(m, a) squared errors of each segment in some channels, less what those of measured states make of them."""
        return [
            rows[:, axes] ** 2 - sum(one[i][:, axes] ** 2 for one in self.of_inputs) / max(len(self.of_inputs), 1)
            for i, rows in enumerate(self.rows)
        ]

    def after(self, skipped: int) -> ModelErrors:
        """Without so many rows at the start of each segment, at most half of it."""

        def rest(parts: Sequence[Floats]) -> list[Floats]:
            return [part[min(skipped, len(part) // 2) :] for part in parts]

        return ModelErrors(rest(self.rows), [rest(one) for one in self.of_inputs])


def differences(one: Sequence[Floats], other: Sequence[Floats]) -> list[Floats]:
    """Differences one - other of the errors, segment by segment."""
    return [a - b for a, b in zip(one, other, strict=True)]


def channel_changes(
    before: ModelErrors, after: ModelErrors, floor: Floats, rate: float, limits: RelevanceThresholds
) -> dict[str, ErrorChange]:
    """By kind of channel, of those that there are.

    before, after: of the same segments. floor: (12,). rate: of the rows, Hz.
    """
    compared = {}
    for i, kind in enumerate(channels.KINDS):
        axes = slice(channels.AXES * i, channels.AXES * (i + 1))
        level = float(np.linalg.norm(floor[axes]))
        if level > 0:
            floors = np.maximum(floor[axes], limits.min_axis_floor * level)
            compared[kind] = _change(before.squares(axes), after.squares(axes), floors, rate, limits)
    return compared


def open_loop_changes(
    before: Mapping[float, ModelErrors],
    after: Mapping[float, ModelErrors],
    motion: Mapping[float, Floats],
    interval: float,
    limits: RelevanceThresholds,
) -> dict[str, ErrorChange]:
    """By quantity, over all horizons together, so that the errors of long ones, which are larger, decide.

    before, after: errors of each segment's windows at each horizon, s. motion: (4,) RMS change of each quantity over
    each of them. interval: between the windows' starts, s.
    """
    compared = {}
    for i, quantity in enumerate(OPEN_LOOP_QUANTITIES):
        old, new = (_over_horizons(errors, [quantity]) for errors in (before, after))
        level = _level(before, quantity)
        if level > 0:
            moved = float(np.sqrt(np.mean([moves[i] ** 2 for moves in motion.values()])))
            compared[quantity] = replace(_change(old, new, np.array([level]), 1 / interval, limits), motion=moved)
    return compared


def open_loop_total(
    before: Mapping[float, ModelErrors],
    after: Mapping[float, ModelErrors],
    quantities: Sequence[str],
    interval: float,
    limits: RelevanceThresholds,
) -> ErrorChange:
    """The change of all errors of the open loop together, each over its size before. Arguments as above."""
    levels = np.array([_level(before, quantity) for quantity in quantities])
    old, new = (_over_horizons(errors, quantities) for errors in (before, after))
    return _change(old, new, levels, 1 / interval, limits)


def _over_horizons(errors: Mapping[float, ModelErrors], quantities: Sequence[str]) -> list[Floats]:
    """(m, q) squared errors of each segment's windows, the mean of all horizons."""

    def squares(of: ModelErrors, quantity: str) -> list[Floats]:
        return [np.sum(e, axis=1) for e in of.squares(_axes(quantity))]

    by_quantity = [[squares(of, quantity) for of in errors.values()] for quantity in quantities]
    count = len(by_quantity[0][0])
    return [np.stack([np.mean([h[i] for h in one], axis=0) for one in by_quantity], axis=1) for i in range(count)]


def _level(errors: Mapping[float, ModelErrors], quantity: str) -> float:
    return _norm([rows[:, _axes(quantity)] ** 2 for of in errors.values() for rows in of.rows])


def _axes(quantity: str) -> slice:
    place = OPEN_LOOP_QUANTITIES.index(quantity)
    return slice(3 * place, 3 * place + 3)


def _change(
    was: Sequence[Floats], now: Sequence[Floats], floors: Floats, rate: float, limits: RelevanceThresholds
) -> ErrorChange:
    """From squared errors (m, a) of each segment. floors: (a,) of the axes."""
    count = sum(map(len, was))
    length = max(1, min(round(limits.block * rate), count // limits.min_blocks))
    blocks = [
        np.add.reduceat((n - w) / floors**2, np.arange(0, len(w), length))
        for w, n in zip(was, now, strict=True)
        if len(w)
    ]
    differences = np.concatenate(blocks)
    pooled = differences.sum(axis=1)
    spread = float(np.linalg.norm(pooled))
    return ErrorChange(
        before=_norm(was),
        after=_norm(now),
        floor=float(np.linalg.norm(floors)),
        by_axis=tuple((differences.sum(axis=0) / max(count, 1)).tolist()),
        deviations=float(pooled.sum()) / spread if spread > 0 else 0.0,
    )


def _norm(squares: Sequence[Floats]) -> float:
    """Root of the mean of squares (m, a) of each segment, summed over the axes."""
    return float(np.sqrt(np.maximum(np.mean(np.sum(np.concatenate(squares), axis=1)), 0.0)))


def relative_rise(change: float) -> float:
    """By how much an error at the floor changes, over the floor, with a change of its square over that of the floor."""
    return float(np.sign(change) * (np.sqrt(1.0 + abs(change)) - 1.0))
