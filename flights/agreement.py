"""How two signals agree that must be one: in size, in sign, along which axes, and in time."""

from __future__ import annotations

import itertools

import numpy as np

from dynamics.arrays import Floats

AGREEMENT = 0.5  # correlation about zero beyond which a comparison is taken seriously
SAME_SIZE = (0.6, 1.67)  # range of a ratio that must be 1
_CLEAR_AGREEMENT = 0.8  # correlation about zero of one motion logged along two axes, or with the opposite sign
_CLEARER = 0.3  # by which that must exceed the correlation along equal axes
_MIN_ROWS = 50  # that can be compared


def rms(values: Floats) -> float:
    """Root mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def agreement(one: Floats, other: Floats) -> float:
    """Correlation about zero: 1 for the same motion, -1 for the opposite one, 0 where one stands still."""
    size = rms(one) * rms(other)
    return float(np.mean(one * other)) / size if size > 0 else 0.0


def both(one: Floats, other: Floats) -> tuple[Floats, Floats] | None:
    """The rows (m, k) of two signals (n, k) where both are finite; None where these are too few to compare."""
    valid = np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
    return (one[valid], other[valid]) if np.count_nonzero(valid) >= _MIN_ROWS else None


def may_be_one_size(ratio: float, agreeing: float) -> bool:
    """Whether two signals of one size may have such a ratio of RMS: of slow motion one may be noise for the most part.

    Noise in one of two equal signals makes it larger by the inverse of their correlation.
    """
    return agreeing > 0 and SAME_SIZE[0] * agreeing < ratio < SAME_SIZE[1] / agreeing


def is_opposite(one: Floats, other: Floats, smallest: float, errors: float = 0.0) -> bool:
    """Whether a signal (n,) is another with the opposite sign. smallest: RMS below which neither tells.

    errors: RMS that both may have by errors of their own, which agree in any way; up to there the sign must be clear.
    """
    size = min(rms(one), rms(other))
    return size > smallest and agreement(one, other) < -(AGREEMENT if size > errors else _CLEAR_AGREEMENT)


def exchanged_axes(one: Floats, other: Floats, smallest: float) -> str:
    """Pairs of axes that agree while equal axes do not, for people; empty if there are none. Both: (n, 3).

    All axes that an order of the columns displaces must say so: one that errs by more than it moves resembles another
    axis along which the vehicle moves with it.
    """
    for order in itertools.permutations(range(3)):
        moving = [(i, j) for i, j in enumerate(order) if i != j and max(rms(one[:, i]), rms(other[:, j])) >= smallest]
        if moving and all(_is_another_axis(one[:, i], other[:, i], other[:, j]) for i, j in moving):
            return ", ".join(f"{'xyz'[i]} and {'xyz'[j]}: {agreement(one[:, i], other[:, j]):.2f}" for i, j in moving)
    return ""


def _is_another_axis(one: Floats, own: Floats, another: Floats) -> bool:
    """Whether a motion agrees with what was logged along another axis, and not with its own. All: (n,)."""
    if 0.0 in (rms(one), rms(own), rms(another)):
        return False
    agreeing = abs(agreement(one, another))
    return agreeing > max(_CLEAR_AGREEMENT, abs(agreement(one, own)) + _CLEARER)


def offset(one: Floats, other: Floats, reach: int, smallest: float) -> tuple[int, float]:
    """By how many rows the other is late, and the rise of their correlation at that shift; zeros where none is clear.

    reach: rows that are tried either way. smallest: RMS below which neither tells.
    """
    best, plain, at = -1.0, 0.0, 0
    if len(one) <= 2 * reach:
        return 0, 0.0
    for shift in range(-reach, reach + 1):
        a = one[max(-shift, 0) : len(one) - max(shift, 0)]
        b = other[max(shift, 0) : len(other) - max(-shift, 0)]
        pair = both(a, b)
        if pair is None or min(map(rms, pair)) < smallest:
            return 0, 0.0
        agreeing = agreement(*pair)
        plain = agreeing if shift == 0 else plain
        if agreeing > best:
            best, at = agreeing, shift
    return (at, best - plain) if best > _CLEAR_AGREEMENT else (0, 0.0)
