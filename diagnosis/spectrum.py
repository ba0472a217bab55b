"""Spectra of a model's residuals and of the sensors' noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
import scipy

from diagnosis.estimation.channel_noise import ChannelNoise
from diagnosis.models.channels import AXES, CHANNELS, KINDS
from dynamics.arrays import Floats

SPECTRUM_ROWS = 128  # of a periodogram


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power densities of the channels, NaN for channels that are absent.

    frequency: (f,) Hz.
    power, noise: (12, f) one-sided density of residual and noise, unit^2/Hz.
    """

    frequency: Floats
    power: Floats
    noise: Floats


class SpectrumLines(msgspec.Struct, frozen=True):
    """A `Spectrum` as JSON holds it: one line a channel, such as "imu x"."""

    frequency: list[float]
    power: dict[str, list[float]]
    noise: dict[str, list[float]]


def residual_spectrum(rows: Sequence[Floats], noise: ChannelNoise) -> Spectrum:
    """Spectra below the filters' cutoff. rows: (m, 12) residuals of each segment."""
    length = min(SPECTRUM_ROWS, *(len(r) for r in rows))
    spectra = [scipy.signal.welch(r, noise.rate, nperseg=length, detrend=False, axis=0) for r in rows]
    frequency = spectra[0][0]
    weights = np.array([len(r) for r in rows], dtype=float)
    power = np.average([p for _, p in spectra], axis=0, weights=weights).T
    model = 2 * noise.density(np.maximum(frequency, frequency[1] / 2))
    absent = noise.floor == 0
    power[absent] = model[absent] = np.nan
    below = frequency <= noise.segments[0].filters.cutoff
    return Spectrum(frequency[below], power[:, below], model[:, below])


def spectrum_lines(spectrum: Spectrum) -> SpectrumLines:
    """A spectrum as JSON holds it, of the channels that there are."""
    there = [c for c in range(CHANNELS) if np.isfinite(spectrum.power[c]).all()]
    names = {c: f"{KINDS[c // AXES]} {'xyz'[c % AXES]}" for c in there}
    power = {names[c]: spectrum.power[c].tolist() for c in there}
    return SpectrumLines(spectrum.frequency.tolist(), power, {names[c]: spectrum.noise[c].tolist() for c in there})
