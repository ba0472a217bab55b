"""Spectra of what a model leaves, against the noise that sensors would leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy.signal import freqz, welch

from diagnosis.data.filters import CUTOFF
from diagnosis.models.channels import AXES, CHANNELS, KINDS
from diagnosis.selection.noise import SEGMENT, NoiseModel
from dynamics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Spectrum:
    """frequency: (f,) Hz. power, noise: (12, f) one-sided density of residual and noise model, unit^2/Hz.

    NaN for channels that are absent.
    """

    frequency: Floats
    power: Floats
    noise: Floats


class SpectrumLines(msgspec.Struct, frozen=True):
    """A `Spectrum` as JSON holds it: one line a channel, such as "imu x"."""

    frequency: list[float]
    power: dict[str, list[float]]
    noise: dict[str, list[float]]


def residual_spectrum(rows: Sequence[Floats], noise: NoiseModel, rate: float) -> Spectrum:
    """Spectra below the filters' cutoff. rows: (m, 12) residuals of each segment at rate Hz."""
    length = min(SEGMENT, *(len(r) for r in rows))
    found = [welch(r, rate, nperseg=length, detrend=False, axis=0) for r in rows]
    frequency = found[0][0]
    weights = np.array([len(r) for r in rows], dtype=float)
    power = np.average([p for _, p in found], axis=0, weights=weights).T
    model = np.full_like(power, np.nan)
    for channel, filter_, level in zip(noise.active, noise.filters, noise.level, strict=True):
        response = freqz(1.0, filter_, worN=frequency, fs=rate)[1]
        model[channel] = 2 * level**2 / rate * np.abs(response) ** 2
    power[np.isnan(model[:, 0])] = np.nan
    below = frequency <= CUTOFF
    return Spectrum(frequency[below], power[:, below], model[:, below])


def spectrum_lines(spectrum: Spectrum) -> SpectrumLines:
    """A spectrum as JSON holds it, of the channels that there are."""
    there = [c for c in range(CHANNELS) if np.isfinite(spectrum.power[c]).all()]
    names = {c: f"{KINDS[c // AXES]} {'xyz'[c % AXES]}" for c in there}
    power = {names[c]: spectrum.power[c].tolist() for c in there}
    return SpectrumLines(spectrum.frequency.tolist(), power, {names[c]: spectrum.noise[c].tolist() for c in there})
