"""How two signals agree that must be one: in size, in sign, along which axes, and in time."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

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


def correlations(one: Floats, other: Floats, shifts: NDArray[np.int_]) -> Floats:
    """Correlation about zero of two signals (n, k) and (m, k) over the rows that both have, at each of the shifts.

    shifts: rows of the first signal before the second one's first row. Rows that are not finite count nowhere.
    """
    length = 1 << (len(one) + len(other) - 1).bit_length()

    def spectrum(values: Floats) -> NDArray[np.complex128]:
        return np.fft.rfft(values, length, axis=0)

    def at_shifts(product: NDArray[np.complex128]) -> Floats:
        return np.asarray(np.fft.irfft(product, length, axis=0)[shifts % length])

    masks = [np.asarray(np.isfinite(values).all(axis=1)) for values in (one, other)]
    a, b = (np.where(mask.reshape(-1, 1), values, 0.0) for mask, values in zip(masks, (one, other), strict=True))
    product = at_shifts((spectrum(a) * spectrum(b).conj()).sum(axis=1))
    power_a = at_shifts(spectrum((a**2).sum(axis=1)) * spectrum(masks[1].astype(float)).conj())
    power_b = at_shifts(spectrum(masks[0].astype(float)) * spectrum((b**2).sum(axis=1)).conj())
    size = np.sqrt(np.maximum(power_a, 0.0) * np.maximum(power_b, 0.0))
    smallest = 1e-9 * float(np.sqrt(np.sum(a**2) * np.sum(b**2)))  # below, nothing but rounding is in it
    return np.where(size > smallest, product / np.where(size > smallest, size, 1.0), 0.0)


def offset(one: Floats, other: Floats, reach: int, smallest: float) -> tuple[int, float]:
    """By how many rows the other is late, and the rise of their correlation at that shift; zeros where none is clear.

    reach: rows that are tried either way. smallest: RMS below which neither tells.
    """
    pair = both(one, other) if len(one) > 2 * reach else None
    if pair is None or min(map(rms, pair)) < smallest:
        return 0, 0.0
    late = np.arange(-reach, reach + 1)
    agreeing = correlations(one, other, -late)
    best = int(np.argmax(agreeing))
    return (int(late[best]), float(agreeing[best] - agreeing[reach])) if agreeing[best] > _CLEAR_AGREEMENT else (0, 0.0)
