"""Spectra of a model's residuals and of the sensors' noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
import scipy

from diagnosis.models.channels import AXES, CHANNELS, KINDS
from diagnosis.selection.noise import NoiseModel
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power densities of the channels, NaN for channels that are absent.

    frequency: (f,) Hz.
    power, noise: (12, f) one-sided density of residual and noise model, unit^2/Hz.
    """

    frequency: Floats
    power: Floats
    noise: Floats


class SpectrumLines(msgspec.Struct, frozen=True):
    """A `Spectrum` as JSON holds it: one line a channel, such as "imu x"."""

    frequency: list[float]
    power: dict[str, list[float]]
    noise: dict[str, list[float]]


def residual_spectrum(
    rows: Sequence[Floats], noise: NoiseModel, rate: float, thresholds: Thresholds = DEFAULT
) -> Spectrum:
    """Spectra below the filters' cutoff. rows: (m, 12) residuals of each segment at rate Hz."""
    length = min(thresholds.noise.spectrum_rows, *(len(r) for r in rows))
    spectra = [scipy.signal.welch(r, rate, nperseg=length, detrend=False, axis=0) for r in rows]
    frequency = spectra[0][0]
    weights = np.array([len(r) for r in rows], dtype=float)
    power = np.average([p for _, p in spectra], axis=0, weights=weights).T
    model = np.full_like(power, np.nan)
    for channel, filter_, level in zip(noise.active, noise.filters, noise.level, strict=True):
        response = scipy.signal.freqz(1.0, filter_, worN=frequency, fs=rate)[1]
        model[channel] = 2 * level**2 / rate * np.abs(response) ** 2
    power[np.isnan(model[:, 0])] = np.nan
    below = frequency <= thresholds.filters.cutoff
    return Spectrum(frequency[below], power[:, below], model[:, below])


def spectrum_lines(spectrum: Spectrum) -> SpectrumLines:
    """A spectrum as JSON holds it, of the channels that there are."""
    there = [c for c in range(CHANNELS) if np.isfinite(spectrum.power[c]).all()]
    names = {c: f"{KINDS[c // AXES]} {'xyz'[c % AXES]}" for c in there}
    power = {names[c]: spectrum.power[c].tolist() for c in there}
    return SpectrumLines(spectrum.frequency.tolist(), power, {names[c]: spectrum.noise[c].tolist() for c in there})
