"""The noise of the residual channels: coloured, correlated between channels, never redder than sensors are.

What is redder below 1.5 Hz than between 1.5 and 3 Hz is physics that the model misses, so the spectrum is capped
there at the latter's level; without the cap a gust would be whitened away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter, welch

from dynamics.arrays import Floats

ORDER = 6
CAP, REFERENCE = 1.5, 3.0  # Hz
SEGMENT = 128  # rows of a spectrum
TORQUES, RED = range(6, 9), 1.5


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """active: the channels that are there. filters: (c, 7) of AR models. level: (c,) innovation. mixing: (c, c).

    floor: (12,) standard deviation of each channel's noise below the filters' cutoff, zero where a channel is absent.
    """

    active: tuple[int, ...]
    filters: Floats
    level: Floats
    mixing: Floats
    floor: Floats

    def whiten(self, rows: Floats) -> Floats:
        """Rows (m, 12) or columns (m, 12, k) as (m - 6, c) or (m - 6, c, k) with unit white noise."""
        count = len(rows) - ORDER
        here = rows[:, list(self.active)]
        shape = (1, len(self.active)) + (1,) * (rows.ndim - 2)
        white = np.zeros((count, *here.shape[1:]))
        for lag in range(ORDER + 1):
            white += (self.filters[:, lag] / self.level).reshape(shape) * here[ORDER - lag : ORDER - lag + count]
        mixed = self.mixing @ white if rows.ndim == 3 else white @ self.mixing.T
        return np.asarray(mixed)

    def whiten_one(self, place: int, values: Floats) -> Floats:
        """Values (m, ...) of the active channel at a place, by its own filter alone: (m - 6, ...)."""
        count = len(values) - ORDER
        parts = (a * values[ORDER - lag : ORDER - lag + count] for lag, a in enumerate(self.filters[place]))
        return np.asarray(sum(parts) / self.level[place])


def estimate_noise(
    residuals: Sequence[Floats], rate: float, active: Sequence[int], *, mixed: bool = True
) -> NoiseModel:
    """The noise of residuals (m, 12) that hold as little physics as possible. rate: Hz.

    mixed: whether what channels have in common is noise too.
    """
    filters, levels, floor = [], [], np.zeros(residuals[0].shape[1])
    for channel in active:
        columns = [r[:, channel] for r in residuals]
        a, variance = _capped_ar(columns, rate)
        innovations = np.concatenate([_fast(lfilter(a, [1.0], x)[ORDER:], rate) for x in columns])
        filters.append(a)
        levels.append(np.sqrt(np.mean(innovations**2) / _fast_share(rate)))
        floor[channel] = np.sqrt(variance)
    unmixed = NoiseModel(tuple(active), np.array(filters), np.array(levels), np.eye(len(active)), floor)
    if not mixed:
        return unmixed
    white = np.vstack([_fast(unmixed.whiten(r), rate) for r in residuals])
    covariance = white.T @ white / len(white) / _fast_share(rate)
    mixing = np.linalg.inv(np.linalg.cholesky(covariance))
    return NoiseModel(unmixed.active, unmixed.filters, unmixed.level, mixing, floor)


def noise_floor(residuals: Sequence[Floats], rate: float, active: Sequence[int]) -> Floats:
    """(12,) standard deviation of the noise in residuals (m, 12), zero where a channel is absent.

    Below 1.5 Hz the mean of the spectrum counts at most as much as that from 1.5 to 3 Hz, or half as much again for
    torques, which the rotors' turbulence reddens. Bin by bin, as for the filters, would count chance as physics.
    """
    floor = np.zeros(residuals[0].shape[1])
    for channel in active:
        frequency, spectrum = _spectrum([r[:, channel] for r in residuals], rate)
        size = np.abs(frequency)
        slow, level = size < CAP, spectrum[(size >= CAP) & (size <= REFERENCE)].mean()
        most = level * (RED if channel in TORQUES else 1.0)
        power = spectrum[~slow].sum() + min(float(spectrum[slow].mean()), float(most)) * slow.sum()
        floor[channel] = np.sqrt(power * rate / len(spectrum))
    return floor


def _capped_ar(columns: Sequence[Floats], rate: float) -> tuple[Floats, float]:
    """Coefficients (1, -a1, .., -a6) from the capped spectrum, and the variance under it."""
    frequency, spectrum = _spectrum(columns, rate)
    size = np.abs(frequency)
    reference = spectrum[(size >= CAP) & (size <= REFERENCE)].mean()
    spectrum = np.where(size < CAP, np.minimum(spectrum, reference), spectrum)
    correlation = np.real(np.fft.ifft(spectrum))
    correlation[0] *= 1 + 1e-4
    a = solve_toeplitz(correlation[:ORDER], correlation[1 : ORDER + 1])
    return np.concatenate([[1.0], -a]), float(correlation[0] * rate)


def _spectrum(columns: Sequence[Floats], rate: float) -> tuple[Floats, Floats]:
    """Frequencies, Hz, both signs, and the mean power density of columns (m,) there."""
    length = min(SEGMENT, *(len(x) for x in columns))
    spectrum, weight = np.zeros(length), 0
    for x in columns:
        frequency, power = welch(x, rate, nperseg=length, detrend=False, return_onesided=False)
        spectrum, weight = spectrum + power * len(x), weight + len(x)
    return np.asarray(frequency), np.asarray(spectrum / weight)


def _fast(values: Floats, rate: float) -> Floats:
    """What varies above 1.5 Hz. values: (m, ...)."""
    spectrum = np.fft.rfft(values, axis=0)
    spectrum[np.fft.rfftfreq(len(values), 1 / rate) < CAP] = 0
    return np.asarray(np.fft.irfft(spectrum, len(values), axis=0))


def _fast_share(rate: float) -> float:
    return 1 - CAP / (rate / 2)
