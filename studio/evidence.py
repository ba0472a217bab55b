"""What the pictures of a diagnosis show, computed from its findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison import WORST, worst_window
from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.selection.regression import Regression
from diagnosis.selection.search import Scored
from dynamics.arrays import Floats

MAX_ROWS = 6000  # of the overlay: four minutes of flight
SHOWN_CANDIDATES = 14  # of the collinearity matrix
PAUSE = 0.5  # s between flights that are shown one behind the other
SCATTERED = 1500  # points a panel


@dataclass(frozen=True, eq=False)
class Overlay:
    """Measured and modelled channels over flights that are shown one behind the other, a row of NaN between them.

    time: (n,) s. measured, current, improved: (n, 12). begins: where each flight begins, s. names: of the flights.
    worst: first and last second of the two worst. missed: (12,) RMS over floor of the current model in them, 0 where a
    channel is absent. left_out: segments that were too many to show.
    """

    time: Floats
    measured: Floats
    current: Floats
    improved: Floats
    begins: tuple[float, ...]
    names: tuple[str, ...]
    worst: tuple[float, float]
    missed: Floats
    left_out: int


def overlay(
    segments: Sequence[Segment], before: Sequence[Floats], after: Sequence[Floats], floor: Floats, rate: float
) -> Overlay:
    """What segments measured and what two models say, from their residuals (m, 12). floor: (12,). rate: Hz, of rows.

    Of more than four minutes the worst segments are shown.
    """
    chosen = _worst_segments(before, floor, rate)
    gap = np.full((1, channels.CHANNELS), np.nan)
    times: list[Floats] = []
    tables: tuple[list[Floats], ...] = ([], [], [])
    begins: list[float] = []
    now = 0.0
    for index in chosen:
        measured = channels.measured(segments[index])
        begins.append(now)
        times.append(now + np.arange(len(measured) + 1) / rate)
        now = float(times[-1][-1]) + PAUSE
        for table, values in zip(tables, (measured, measured - before[index], measured - after[index]), strict=True):
            table.append(np.vstack([values, gap]))
    place, row, _ = worst_window([before[i] for i in chosen], floor, rate)
    start = begins[place] + row / rate
    inside = before[chosen[place]][row : row + round(WORST * rate)]
    over_floor = np.sqrt(np.mean(inside**2, axis=0)) / np.where(floor > 0, floor, np.inf)
    return Overlay(
        time=np.concatenate(times),
        measured=np.vstack(tables[0]),
        current=np.vstack(tables[1]),
        improved=np.vstack(tables[2]),
        begins=tuple(begins),
        names=tuple(Path(segments[i].flight).name for i in chosen),
        worst=(start, start + WORST),
        missed=over_floor,
        left_out=len(segments) - len(chosen),
    )


def _worst_segments(rows: Sequence[Floats], floor: Floats, rate: float) -> list[int]:
    """Places of the segments with the worst two seconds, in their order, as many as can be shown."""
    worst_first = sorted(range(len(rows)), key=lambda i: -worst_window([rows[i]], floor, rate)[2])
    chosen: list[int] = []
    for index in worst_first:
        if not chosen or sum(len(rows[i]) for i in chosen) + len(rows[index]) <= MAX_ROWS:
            chosen.append(index)
    return sorted(chosen)


@dataclass(frozen=True, eq=False)
class Agreement:
    """Residuals of accelerometer and pose, (n, 3) m/s^2 each, and how they agree.

    correlation: (3,), one an axis.
    """

    imu: Floats
    mocap: Floats
    correlation: Floats


def agreement(rows: Sequence[Floats]) -> Agreement | None:
    """What accelerometer and pose miss in the model, side by side; None where one of them is not in the log."""
    table = np.vstack(rows)
    imu, mocap = table[:, 0:3], table[:, 3:6]
    if not imu.any() or not mocap.any():
        return None
    correlation = np.array([np.corrcoef(imu[:, axis], mocap[:, axis])[0, 1] for axis in range(3)])
    thin = slice(None, None, max(1, len(table) // SCATTERED))
    return Agreement(imu[thin], mocap[thin], correlation)


@dataclass(frozen=True, eq=False)
class Likeness:
    """How much the signals of effects have in common on these flights. names: (k,). shared: (k, k) from 0 to 1."""

    names: tuple[str, ...]
    shared: Floats


def likeness(regression: Regression, singles: Sequence[Scored]) -> Likeness:
    """The largest canonical correlation of each two effects' whitened columns, biases taken out.

    singles: each effect's best variant, best first; the first ones are taken.
    """
    gram: Floats = np.sum(regression.plain_gram, axis=0)
    taken = [s for s in singles if np.all(np.diag(gram)[s.columns] > 0)][:SHOWN_CANDIDATES]
    places: list[NDArray[np.intp]] = [np.array(s.columns, dtype=np.intp) for s in taken]
    roots = [_inverse_root(gram[np.ix_(p, p)]) for p in places]
    shared = np.eye(len(taken))
    for i, one in enumerate(places):
        for j, other in enumerate(places[:i]):
            across = roots[i] @ gram[np.ix_(one, other)] @ roots[j].T
            shared[i, j] = shared[j, i] = min(1.0, float(np.linalg.norm(across, 2)))
    return Likeness(tuple(s.candidates[0].key for s in taken), shared)


def _inverse_root(matrix: Floats) -> Floats:
    """W with W M W' = 1, for as much of M as is not singular."""
    values, vectors = np.linalg.eigh(matrix)
    good = values > 1e-9 * values[-1]
    return np.asarray((vectors[:, good] / np.sqrt(values[good])).T)


def by_kind(thrice: Floats) -> Floats:
    """(4, f) sum over the three axes of (12, f), NaN for kinds that are absent."""
    return np.asarray(thrice.reshape(len(channels.KINDS), channels.AXES, -1).sum(axis=1))
