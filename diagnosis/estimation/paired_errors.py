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

    before, after: RMS.
    floor: with which it is compared.
    deviations: the change of the squared error over its standard deviation, positive where it rises.
    size: RMS of the difference of the predictions.
    shortfall: by how many deviations the squared error falls by less than half of the squared size, all of which it
        would fall by if the difference were real.
    """

    before: float
    after: float
    floor: float
    deviations: float
    size: float = 0.0
    shortfall: float = 0.0

    @property
    def rise(self) -> float:
        """How much an error at the floor would change, over the floor; negative where it falls."""
        return _rise(self.after**2 - self.before**2, self.floor)

    def is_worse(self, limits: RelevanceThresholds = DEFAULT.relevance) -> bool:
        """Whether the error rises by more than chance, and enough to matter."""
        return self.rise > limits.max_rise and self.deviations > limits.deviations

    def is_contradicted(self, limits: RelevanceThresholds = DEFAULT.relevance) -> bool:
        """Whether the difference would matter, but the error does not fall as if it were real."""
        return _rise(self.size**2, self.floor) >= limits.min_rise and self.shortfall > limits.deviations


def channel_changes(
    before: Sequence[Floats], after: Sequence[Floats], floor: Floats, rate: float, limits: RelevanceThresholds
) -> dict[str, ErrorChange]:
    """By kind of channel, of those that there are.

    before, after: (m, 12) residuals of the same segments. floor: (12,). rate: of the rows, Hz.
    """
    levels = np.sqrt(channels.squared_by_kind(floor))
    was, now, difference = (
        [channels.squared_by_kind(rows) for rows in part]
        for part in (before, after, [a - b for a, b in zip(after, before, strict=True)])
    )
    compared = {}
    for i, kind in enumerate(channels.KINDS):
        if levels[i] > 0:
            old, new, size = ([rows[:, i] for rows in part] for part in (was, now, difference))
            change = _change(old, new, float(levels[i]), rate, limits)
            expected = [w - d / 2 for w, d in zip(old, size, strict=True)]
            compared[kind] = replace(
                change,
                size=float(np.sqrt(np.mean(np.concatenate(size)))),
                shortfall=_change(expected, new, float(levels[i]), rate, limits).deviations,
            )
    return compared


def open_loop_changes(
    before: Mapping[float, Sequence[Floats]],
    after: Mapping[float, Sequence[Floats]],
    interval: float,
    limits: RelevanceThresholds,
) -> dict[tuple[float, str], ErrorChange]:
    """By horizon, s, and quantity.

    before, after: (W, 12) errors of each segment's windows at each horizon. interval: between their starts, s. The
    floor of each is its error before.
    """
    compared = {}
    for horizon, was in before.items():
        for i, quantity in enumerate(OPEN_LOOP_QUANTITIES):
            axes = slice(3 * i, 3 * i + 3)
            old, new = ([np.sum(e[:, axes] ** 2, axis=1) for e in part] for part in (was, after[horizon]))
            level = float(np.sqrt(np.mean(np.concatenate(old))))
            if level > 0:
                compared[horizon, quantity] = _change(old, new, level, 1 / interval, limits)
    return compared


def _change(
    was: Sequence[Floats], now: Sequence[Floats], floor: float, rate: float, limits: RelevanceThresholds
) -> ErrorChange:
    """From squared errors (m,) of each segment."""
    count = sum(map(len, was))
    length = max(1, min(round(limits.block * rate), count // limits.min_blocks))
    differences = np.concatenate(
        [np.add.reduceat(n - w, np.arange(0, len(w), length)) for w, n in zip(was, now, strict=True) if len(w)]
    )
    spread = float(np.sqrt(np.sum(differences**2)))
    before, after = (float(np.sqrt(np.maximum(np.mean(np.concatenate(part)), 0.0))) for part in (was, now))
    return ErrorChange(before, after, floor, float(differences.sum()) / spread if spread > 0 else 0.0)


def _rise(squared: float, floor: float) -> float:
    """By how much an error at the floor changes, over the floor, with a change of the squared error."""
    change = squared / max(floor, 1e-12) ** 2
    return float(np.sign(change) * (np.sqrt(1.0 + abs(change)) - 1.0))
