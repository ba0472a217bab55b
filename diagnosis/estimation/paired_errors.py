"""Two models on the same rows: by how much an error changes, and whether by more than chance.

Errors are correlated in time, so that rows are summed over blocks first. Differences of squared errors count, since
what else is missing, such as a gust, adds to both and cancels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
    """

    before: float
    after: float
    floor: float
    deviations: float

    @property
    def rise(self) -> float:
        """How much an error at the floor would change, over the floor; negative where it falls."""
        change = (self.after**2 - self.before**2) / max(self.floor, 1e-12) ** 2
        return float(np.sign(change) * (np.sqrt(1.0 + abs(change)) - 1.0))

    def is_worse(self, limits: RelevanceThresholds = DEFAULT.relevance) -> bool:
        """Whether the error rises by more than chance, and enough to matter."""
        return self.rise > limits.max_rise and self.deviations > limits.deviations


def channel_changes(
    before: Sequence[Floats], after: Sequence[Floats], floor: Floats, rate: float, limits: RelevanceThresholds
) -> dict[str, ErrorChange]:
    """By kind of channel, of those that there are.

    before, after: (m, 12) residuals of the same segments. floor: (12,). rate: of the rows, Hz.
    """
    levels = np.sqrt(channels.squared_by_kind(floor))
    was, now = ([channels.squared_by_kind(rows) for rows in part] for part in (before, after))
    return {
        kind: _change([w[:, i] for w in was], [n[:, i] for n in now], float(levels[i]), rate, limits)
        for i, kind in enumerate(channels.KINDS)
        if levels[i] > 0
    }


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
    before, after = (float(np.sqrt(np.mean(np.concatenate(part)))) for part in (was, now))
    return ErrorChange(before, after, floor, float(differences.sum()) / spread if spread > 0 else 0.0)
