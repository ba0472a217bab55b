"""The strongest line in the spectrum of residuals, and how strong one is by chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from diagnosis.models.channels import MOTION
from diagnosis.thresholds import ResidualTestThresholds
from dynamics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Line:
    """A line in the spectrum of one channel.

    channel: place among the nine of motion.
    frequency: Hz.
    over_surroundings: its power over the median of the spectrum around it.
    rms: of the sine that stands out from its surroundings, in the channel's unit.
    part: (m,) the sine of each segment.
    """

    channel: int
    frequency: float
    over_surroundings: float
    rms: float
    part: tuple[Floats, ...] = field(repr=False)


def strongest_line(
    rows: Sequence[Floats],
    rate: float,
    thresholds: ResidualTestThresholds,
    left_over: NDArray[np.bool_] | None = None,
) -> Line:
    """The line that exceeds its surroundings most. rows: (m, 12) residuals of each segment at rate Hz.

    left_over: (f, 9) where there is none, since it is what a form leaves of the motion (`left_of_motion`).
    """
    power, median = _spectrum([r[:, MOTION] for r in rows], thresholds)
    band, frequency = _band(rate, thresholds)
    over = (power / median if left_over is None else np.where(left_over, 0.0, power / median))[band]
    place, channel = np.unravel_index(int(np.argmax(over)), over.shape)
    width, used = float(frequency[1] - frequency[0]), thresholds.line_rows
    near = float(frequency[place]) + width * np.linspace(-0.5, 0.5, thresholds.line_refinement)
    sines = [tuple(_sine(r[:used, channel], at, rate, len(r)) for r in rows) for at in near]
    powers = [float(np.mean(np.concatenate([p[:used] for p in part]) ** 2)) for part in sines]
    at, part, size = max(zip(near, sines, powers, strict=True), key=lambda one: one[2])
    greatest = float(over[place, channel])
    shown = max(0.0, 1 - 1 / greatest)  # the rest of the sine is noise of its surroundings
    return Line(int(channel), float(at), greatest, float(np.sqrt(shown * size)), part)


def left_of_motion(
    rows: Sequence[Floats],
    explained: Sequence[Floats],
    thresholds: ResidualTestThresholds,
    *,
    max_share: float,
    max_rms: Floats,
) -> NDArray[np.bool_]:
    """(f, 9) where a line of residuals is one of the motion that an imperfect form leaves in part.

    A periodic manoeuvre is lines at its harmonics, and what a form leaves of it as well: there the motion stands out
    from its surroundings by as much. A periodic cause that nothing names is a line elsewhere, or a larger one.
    rows, explained: (m, 12) residuals of each segment, and what the model explains there. max_share: of its power that
    a form may leave. max_rms: (9,) of a line.
    """
    power, median = _spectrum([r[:, MOTION] for r in rows], thresholds)
    moved, around = _spectrum([x[:, MOTION] - x[:, MOTION].mean(axis=0) for x in explained], thresholds)
    lengths = np.array([min(len(r), thresholds.line_rows) for r in rows])
    rms = np.sqrt(8 * power / np.sum(lengths**2))  # of a sine under a window of Hann
    stands_out = moved * median >= power * around
    return np.asarray(stands_out & (power <= max_share * moved) & (rms <= max_rms))


def line_by_chance(rows: Sequence[Floats], rate: float, thresholds: ResidualTestThresholds) -> float:
    """Power over its surroundings that the strongest line of noise exceeds with the probability `chance`.

    The noise is the residuals themselves with random signs, which have no lines but the same power at every moment: a
    short log, or one whose power is in a few moments, has few independent powers at each frequency. The logarithms of
    the strongest lines of `line_draws` draws are given the distribution of Gumbel by their moments.
    rows: (m, 12) residuals of each segment at rate Hz.
    """
    random = np.random.default_rng(0)
    motion = [r[:, MOTION] for r in rows]
    band, _ = _band(rate, thresholds)
    lines = []
    for _ in range(thresholds.line_draws):
        power, median = _spectrum([r * random.choice([-1.0, 1.0], size=(len(r), 1)) for r in motion], thresholds)
        lines.append(np.log(np.max((power / median)[band])))
    scale = float(np.std(lines)) * np.sqrt(6) / np.pi
    mode = float(np.mean(lines)) - np.euler_gamma * scale
    return float(np.exp(mode - scale * np.log(-np.log1p(-thresholds.chance))))


def _spectrum(rows: Sequence[Floats], thresholds: ResidualTestThresholds) -> tuple[Floats, Floats]:
    """Power (f, 9) of rows (m, 9), and its median around each frequency."""
    count = thresholds.line_rows
    power = np.zeros((count // 2 + 1, rows[0].shape[1]))
    for r in rows:
        used = r[:count]
        power += np.abs(np.fft.rfft(used * np.hanning(len(used))[:, None], count, axis=0)) ** 2
    median = scipy.ndimage.median_filter(power, size=(thresholds.line_surroundings, 1), mode="nearest")
    return power, np.maximum(median, 1e-12)


def _band(rate: float, thresholds: ResidualTestThresholds) -> tuple[NDArray[np.bool_], Floats]:
    """Which frequencies are in the line band, and these, Hz."""
    frequency = np.fft.rfftfreq(thresholds.line_rows, 1 / rate)
    inside = (frequency > thresholds.line_band[0]) & (frequency < thresholds.line_band[1])
    return np.asarray(inside), np.asarray(frequency[inside])


def _sine(values: Floats, frequency: float, rate: float, count: int) -> Floats:
    """(count,) the sine of a frequency, Hz, that fits values (m,) best."""
    angle = 2 * np.pi * frequency * np.arange(count) / rate
    waves = np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(waves @ np.linalg.lstsq(waves[: len(values)], values, rcond=None)[0])
