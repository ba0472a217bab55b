"""The noise of the residual channels: coloured, correlated between channels, with a capped low-frequency part.

Power below 1.5 Hz in excess of that between 1.5 and 3 Hz comes from effects that the model misses, so the spectrum is
capped there at the latter's level; without the cap a gust would be whitened away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import msgspec
import numpy as np
import scipy
from numpy.lib.stride_tricks import as_strided
from scipy.linalg import solve_toeplitz

from diagnosis.models.channels import ANGULAR_ACCELERATION, AXES, POSE_ACCELERATION, SPECIFIC_FORCE
from diagnosis.models.pose_errors import NO_ERRORS, PoseErrors
from diagnosis.thresholds import DEFAULT, FilterThresholds, NoiseThresholds
from dynamics.arrays import Floats
from flights.filters import zero_phase

TORQUES = range(ANGULAR_ACCELERATION.start, ANGULAR_ACCELERATION.stop)


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Autoregressive noise of each channel, with correlated innovations.

    active: the channels that are there.
    filters: (c, order + 1) of the AR models.
    level: (c,) standard deviation of the innovations.
    mixing: (c, c) matrix that makes the innovations independent.
    floor: (12,) standard deviation of each channel's noise below the filters' cutoff, zero where a channel is absent.
    """

    active: tuple[int, ...]
    filters: Floats
    level: Floats
    mixing: Floats
    floor: Floats

    @property
    def order(self) -> int:
        """Order of the AR models: rows at the start of a segment that whitening needs."""
        return int(self.filters.shape[1]) - 1

    @cached_property
    def _weights(self) -> Floats:
        """(c, (order + 1) c) of the rows that whitening takes, the earliest first: mixing, AR model and level."""
        scaled = self.filters[:, ::-1] / self.level[:, None]
        return np.hstack([self.mixing * scaled[:, lag] for lag in range(self.order + 1)])

    def whiten(self, rows: Floats) -> Floats:
        """Rows (m, 12) or columns (m, 12, k) as (m - order, c) or (m - order, c, k) with unit white noise."""
        everything = self.active == tuple(range(rows.shape[1]))
        here = np.ascontiguousarray(rows if everything else rows[:, list(self.active)], dtype=float)
        width = here[0, 0].size
        shape = (len(here) - self.order, (self.order + 1) * len(self.active), width)
        windows = as_strided(here, shape, (here.strides[0], width * here.itemsize, here.itemsize), writeable=False)
        return np.asarray((self._weights @ windows).reshape(shape[0], *here.shape[1:]))


def estimate_noise(
    residuals: Sequence[Floats],
    rate: float,
    active: Sequence[int],
    *,
    mixed: bool = True,
    pose: PoseErrors = NO_ERRORS,
    beyond_feedback: Sequence[Floats] = (),
    thresholds: NoiseThresholds = DEFAULT.noise,
) -> NoiseModel:
    """The noise of residuals (m, 12) that hold as little of missing effects as possible. rate: Hz.

    mixed: whether correlation between channels is noise, and whitened.
    pose: slow errors that are noise as well.
    beyond_feedback: residuals that a controller's answer to turbulence has explained nothing of; of each torque the
        larger of both spectra counts.
    """
    if pose.there:
        order, spectrum_rows = thresholds.slow_order, thresholds.slow_spectrum_rows
        thresholds = msgspec.structs.replace(thresholds, order=order, spectrum_rows=spectrum_rows)
    filters, levels, floor = [], [], np.zeros(residuals[0].shape[1])
    start = thresholds.reference_band[0]
    fast_share = 1 - start / (rate / 2)
    for channel in active:
        sets = [residuals, beyond_feedback] if beyond_feedback and channel in TORQUES else [residuals]
        parts = [[r[:, channel] for r in one] for one in sets]
        a, variance = _capped_ar(parts, rate, channel, pose, thresholds)
        innovations = [
            [_above(scipy.signal.lfilter(a, [1.0], x)[thresholds.order :], rate, start) for x in one] for one in parts
        ]
        filters.append(a)
        levels.append(np.sqrt(max(np.mean(np.concatenate(one) ** 2) for one in innovations) / fast_share))
        floor[channel] = np.sqrt(variance)
    unmixed = NoiseModel(tuple(active), np.array(filters), np.array(levels), np.eye(len(active)), floor)
    if pose.there:
        return _counted_once(unmixed, residuals, rate, start)
    if not mixed:
        return unmixed
    white = np.vstack([_above(unmixed.whiten(r), rate, start) for r in residuals])
    covariance = white.T @ white / len(white) / fast_share
    mixing = np.linalg.inv(np.linalg.cholesky(covariance))
    return NoiseModel(unmixed.active, unmixed.filters, unmixed.level, mixing, floor)


def _counted_once(noise: NoiseModel, residuals: Sequence[Floats], rate: float, start: float) -> NoiseModel:
    """The noise where the pose's acceleration is the accelerometer's own: what they share counts as one measurement.

    Two channels whose noise correlates by r know as much of a common signal as two independent ones of 1 + r times the
    variance. Decorrelating them instead would make their difference, which is the estimator's correction, seem precise.
    start: Hz, above which the correlation is found.
    """
    white = np.vstack([_above(noise.whiten(r), rate, start) for r in residuals])
    level, places = noise.level.copy(), {channel: place for place, channel in enumerate(noise.active)}
    for axis in range(AXES):
        force, pose = (places.get(part.start + axis) for part in (SPECIFIC_FORCE, POSE_ACCELERATION))
        if force is None or pose is None:
            continue
        shared = float(np.corrcoef(white[:, force], white[:, pose])[0, 1])
        level[[force, pose]] *= np.sqrt(1 + max(shared, 0.0))
    return replace(noise, level=level)


def noise_floor(
    residuals: Sequence[Floats],
    rate: float,
    active: Sequence[int],
    thresholds: NoiseThresholds = DEFAULT.noise,
    *,
    pose: PoseErrors = NO_ERRORS,
) -> Floats:
    """(12,) standard deviation of the noise in residuals (m, 12), zero where a channel is absent.

    Below the reference band the mean of the spectrum counts at most as much as within it, times `torque_redness` for
    torques, to which the rotors' turbulence adds low frequencies. A cap bin by bin, as for the filters, would count
    chance as missing effects.
    pose: slow errors that count as well, as far as they are there.
    """
    floor = np.zeros(residuals[0].shape[1])
    start, stop = thresholds.reference_band
    for channel in active:
        frequency, spectrum = _spectrum([r[:, channel] for r in residuals], rate, thresholds.spectrum_rows)
        size = np.abs(frequency)
        slow, level = size < start, spectrum[(size >= start) & (size <= stop)].mean()
        limit = level * (thresholds.torque_redness if channel in TORQUES else 1.0)
        limit += pose.density(frequency[slow])[channel].mean()
        power = spectrum[~slow].sum() + min(float(spectrum[slow].mean()), float(limit)) * slow.sum()
        floor[channel] = np.sqrt(power * rate / len(spectrum))
    return floor


def sensor_floor(
    rows: Sequence[Floats], rate: float, filters: FilterThresholds, thresholds: NoiseThresholds = DEFAULT.noise
) -> Floats:
    """(12,) standard deviation, below the filters' cutoff, of what reaches beyond it as sensors' noise does.

    Above the cutoff a spectrum is fitted by white noise, the derivative of white noise and the tail of motion, which
    falls as 1 / f^2; the first two are continued below it.
    rows: (n, 12) unfiltered residuals at rate Hz, differentiated by central differences.
    """
    band = sensors_band(rate, filters, thresholds)
    frequency: Floats = np.asarray(np.fft.rfftfreq(thresholds.sensor_rows, 1 / rate), dtype=float)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    response = np.sinc(2 * frequency / rate) ** 2  # of central differences; Simpson's weights are much the same
    passed = response * _low_pass_gain(rate, filters.cutoff, frequency) ** 2
    floor = np.zeros(rows[0].shape[1])
    for channel in range(len(floor)):
        columns = [r[:, channel] for r in rows if len(r) >= thresholds.sensor_rows]
        if not columns or not any(np.any(x) for x in columns):
            continue
        power = _spectrum(columns, rate, thresholds.sensor_rows)[1][: len(frequency)]
        fitted = power[inside] / response[inside]
        shapes = np.column_stack([np.ones(len(fitted)), frequency[inside] ** 2, frequency[inside] ** -2.0])
        (white, rising, _), _ = scipy.optimize.nnls(shapes / fitted[:, None], np.ones(len(fitted)))
        total = np.sum((white + rising * frequency**2) * passed) * 2 * frequency[1]
        floor[channel] = np.sqrt(total)
    return floor


def white_density(
    columns: Sequence[Floats], rate: float, band: tuple[float, float], thresholds: NoiseThresholds = DEFAULT.noise
) -> float:
    """Two-sided power density of white noise in a band, Hz, beside the tail of motion, which falls as 1 / f^2.

    columns: (n,) each, at rate Hz. The likeliest of spectral lines that are exponentially distributed.
    """
    frequency, power = _spectrum(columns, rate, thresholds.sensor_rows)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    shapes, lines = np.column_stack([np.ones(np.count_nonzero(inside)), frequency[inside] ** -2.0]), power[inside]
    expected, white = np.full(len(lines), lines.mean()), 0.0
    for _ in range(thresholds.reweightings if lines.all() else 0):
        (white, tail), _ = scipy.optimize.nnls(shapes / expected[:, None], lines / expected)
        expected = shapes @ [white, tail]
    return float(white)


def sensors_band(rate: float, filters: FilterThresholds, thresholds: NoiseThresholds) -> tuple[float, float]:
    """Frequencies that only sensors reach, Hz."""
    low, high = (factor * filters.cutoff for factor in thresholds.sensor_band)
    return low, min(high, thresholds.sensor_share * rate)


def _low_pass_gain(rate: float, cutoff: float, frequency: Floats) -> Floats:
    """Gain of the regression's low-pass at frequencies, Hz."""
    impulse = np.zeros(2 * round(rate) + 1)
    impulse[len(impulse) // 2] = 1.0
    gain = np.abs(np.fft.rfft(zero_phase(impulse, rate, cutoff)))
    return np.asarray(np.interp(frequency, np.fft.rfftfreq(len(impulse), 1 / rate), gain))


def _capped_ar(
    parts: Sequence[Sequence[Floats]], rate: float, channel: int, pose: PoseErrors, thresholds: NoiseThresholds
) -> tuple[Floats, float]:
    """Coefficients (1, -a1, .., -an) from the capped spectrum, of parts the largest, and the variance under it."""
    order, (start, stop) = thresholds.order, thresholds.reference_band
    spectra = [_spectrum(columns, rate, thresholds.spectrum_rows) for columns in parts]
    frequency, spectrum = spectra[0][0], np.max([power for _, power in spectra], axis=0)
    size = np.abs(frequency)
    reference = spectrum[(size >= start) & (size <= stop)].mean()
    limit = reference + pose.density(frequency)[channel]
    spectrum = np.where(size < start, np.minimum(spectrum, limit), spectrum)
    correlation = np.real(np.fft.ifft(spectrum))
    correlation[0] *= 1 + 1e-4
    a = solve_toeplitz(correlation[:order], correlation[1 : order + 1])
    return np.concatenate([[1.0], -a]), float(correlation[0] * rate)


def _spectrum(columns: Sequence[Floats], rate: float, rows: int) -> tuple[Floats, Floats]:
    """Frequencies, Hz, both signs, and the mean power density of columns (m,) there. rows: of a periodogram."""
    length = min(rows, *(len(x) for x in columns))
    spectrum, weight = np.zeros(length), 0
    for x in columns:
        frequency, power = scipy.signal.welch(x, rate, nperseg=length, detrend=False, return_onesided=False)
        spectrum, weight = spectrum + power * len(x), weight + len(x)
    return np.asarray(frequency), np.asarray(spectrum / weight)


def _above(values: Floats, rate: float, frequency: float) -> Floats:
    """The part of values (m, ...) at and above a frequency, Hz."""
    spectrum = np.fft.rfft(values, axis=0)
    spectrum[np.fft.rfftfreq(len(values), 1 / rate) < frequency] = 0
    return np.asarray(np.fft.irfft(spectrum, len(values), axis=0))
