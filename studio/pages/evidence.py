"""Data of the pictures of a diagnosis: overlay, agreement of the forces, likeness of effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diagnosis.comparison import worst_window
from diagnosis.data.segment import Segment
from diagnosis.diagnose import DiagnosisDetails
from diagnosis.estimation.channel_noise import ChannelNoise
from diagnosis.models import channels
from dynamics.arrays import Floats

MAX_ROWS = 6000  # of the overlay: four minutes of flight
SHOWN_CANDIDATES = 14  # of the collinearity matrix
PAUSE = 0.5  # s between flights that are drawn one behind the other
MAX_POINTS = 1500  # of a panel of the agreement


@dataclass(frozen=True, eq=False)
class Overlay:
    """Measured and modelled channels over flights that are shown one behind the other, a row of NaN between them.

    time: (n,) s.
    measured, current, improved: (n, 12).
    begins: where each flight begins, s.
    names: of the flights.
    worst: start and end of the worst window, s.
    worst_over_floor: (12,) RMS over floor of the current model in it, 0 where a channel is absent.
    left_out: segments that were too many to show.
    """

    time: Floats
    measured: Floats
    current: Floats
    improved: Floats
    begins: tuple[float, ...]
    names: tuple[str, ...]
    worst: tuple[float, float]
    worst_over_floor: Floats
    left_out: int


def overlay(
    segments: Sequence[Segment], before: Sequence[Floats], after: Sequence[Floats], noise: ChannelNoise
) -> Overlay:
    """Measured channels of segments and those of two models, from their residuals (m, 12).

    Of more than four minutes the worst segments are shown. noise: of the fitted flights.
    """
    floor, rate = noise.floor, noise.rate
    duration = noise.thresholds.regimes.worst_window
    worst_first = sorted(range(len(before)), key=lambda i: -worst_window([before[i]], floor, rate, duration)[2])
    chosen = _as_many_as_fit(worst_first, before)
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
    place, row, _ = worst_window([before[i] for i in chosen], floor, rate, duration)
    start = begins[place] + row / rate
    inside = before[chosen[place]][row : row + round(duration * rate)]
    over_floor = np.sqrt(np.mean(inside**2, axis=0)) / np.where(floor > 0, floor, np.inf)
    return Overlay(
        time=np.concatenate(times),
        measured=np.vstack(tables[0]),
        current=np.vstack(tables[1]),
        improved=np.vstack(tables[2]),
        begins=tuple(begins),
        names=tuple(Path(segments[i].flight).name for i in chosen),
        worst=(start, start + duration),
        worst_over_floor=over_floor,
        left_out=len(segments) - len(chosen),
    )


def _as_many_as_fit(worst_first: Sequence[int], rows: Sequence[Floats]) -> list[int]:
    """The first of these segments, as many as can be shown, in order of time."""
    chosen: list[int] = []
    for index in worst_first:
        if not chosen or sum(len(rows[i]) for i in chosen) + len(rows[index]) <= MAX_ROWS:
            chosen.append(index)
    return sorted(chosen)


@dataclass(frozen=True, eq=False)
class Agreement:
    """Residuals of accelerometer and pose, and their correlation.

    specific_force, pose_acceleration: (n, 3) m/s^2.
    correlation: (3,), of each axis.
    """

    specific_force: Floats
    pose_acceleration: Floats
    correlation: Floats


def agreement(rows: Sequence[Floats]) -> Agreement | None:
    """Residuals of accelerometer and pose; None where one of them is not in the log. rows: (m, 12)."""
    table = np.vstack(rows)
    force, pose = table[:, channels.SPECIFIC_FORCE], table[:, channels.POSE_ACCELERATION]
    if not force.any() or not pose.any():
        return None
    correlation = np.array([np.corrcoef(force[:, axis], pose[:, axis])[0, 1] for axis in range(3)])
    thin = slice(None, None, max(1, len(table) // MAX_POINTS))
    return Agreement(force[thin], pose[thin], correlation)


@dataclass(frozen=True, eq=False)
class Likeness:
    """How much the signals of effects have in common on these flights.

    names: (k,) of the effects.
    shared: (k, k) from 0 to 1.
    """

    names: tuple[str, ...]
    shared: Floats


def likeness(details: DiagnosisDetails) -> Likeness:
    """The largest canonical correlation of each two effects' whitened columns; the first effects are shown.

    Beside all nuisances of the likelihood.
    """
    gram = details.likelihood.search.total.M
    taken = [one for one in details.tried if np.all(np.diag(gram)[list(one.columns)] > 0)][:SHOWN_CANDIDATES]
    places: list[NDArray[np.intp]] = [np.array(one.columns, dtype=np.intp) for one in taken]
    roots = [_inverse_root(gram[np.ix_(p, p)]) for p in places]
    shared = np.eye(len(taken))
    for i, one in enumerate(places):
        for j, other in enumerate(places[:i]):
            across = roots[i] @ gram[np.ix_(one, other)] @ roots[j].T
            shared[i, j] = shared[j, i] = min(1.0, float(np.linalg.norm(across, 2)))
    return Likeness(tuple(one.candidate.key for one in taken), shared)


def _inverse_root(matrix: Floats) -> Floats:
    """W with W M W' = 1, for as much of M as is not singular."""
    values, vectors = np.linalg.eigh(matrix)
    good = values > 1e-9 * values[-1]
    return np.asarray((vectors[:, good] / np.sqrt(values[good])).T)


def by_kind(by_channel: Floats) -> Floats:
    """(4, f) sum over the three axes of (12, f), NaN for kinds that are absent."""
    return np.asarray(by_channel.reshape(len(channels.KINDS), channels.AXES, -1).sum(axis=1))
