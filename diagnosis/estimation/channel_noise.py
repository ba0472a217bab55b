"""Noise of the residual channels by the likelihood's noise: the error that a right model would have.

The likelihood's noise has a density in every reading (`noise.linear_model`). A residual channel is a linear operator on
the readings: derivatives, less what the model predicts of other readings. So the channel's noise has the density
T S T* of that operator T and of the readings' cross density S (Brown and Hwang, Introduction to Random Signals and
Applied Kalman Filtering, 2012, ch. 3), and its floor is the root of the integral below the filters' cutoff.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.estimation.sensor_errors import SensorErrors
from diagnosis.likelihood.gain import Plant, combined
from diagnosis.likelihood.noise_fit import DISTURBANCES, NoiseFit
from diagnosis.likelihood.problem import Problem
from diagnosis.models import channels
from diagnosis.noise.composition import Composition
from diagnosis.noise.linear_model import Complex
from diagnosis.thresholds import Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.rotation_matrix import skew
from dynamics.vehicle import Vehicle
from flights.filters import zero_phase

SLOW = "slow_turbulence"


@dataclass(eq=False)
class ChannelNoise:
    """The noise of fitted flights in their residual channels, and the model of the vehicle file that they are about.

    segments: the fitted flights. problems, fits: of each kind of logs, with its noise.
    slow: whether a slow force counts as noise; without it it is an error that something makes, as a gust does.
    """

    segments: Sequence[Segment]
    problems: Sequence[Problem]
    fits: Sequence[NoiseFit]
    thresholds: Thresholds
    slow: bool = True

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle file's, with what lies between commands and thrust."""
        return self.problems[0].vehicle

    @property
    def catalogue(self) -> Mapping[str, Effect]:
        """Effects by name, those included."""
        return self.problems[0].catalogue

    @property
    def rate(self) -> float:
        """Of the residuals' rows, Hz."""
        return self.segments[0].decimated_rate

    @property
    def drifts(self) -> bool:
        """Whether an estimator made a pose, whose velocity errs slowly."""
        return any(segment.pose_source == "estimator" for segment in self.segments)

    @cached_property
    def sensor_errors(self) -> SensorErrors:
        """Errors of the sensors within specification, for any segment."""
        return SensorErrors(self.vehicle, self.catalogue, self.segments, self.thresholds)

    @cached_property
    def floor(self) -> Floats:
        """(12,) standard deviation of each channel's noise, zero where a channel is absent."""
        return self._level(() if self.slow else (SLOW,))

    @cached_property
    def sensors(self) -> Floats:
        """(12,) the part of it that sensors make; the rest is the rotors' turbulence."""
        return np.minimum(self._level(DISTURBANCES), self.floor)

    @cached_property
    def _plants(self) -> list[Plant]:
        return [problem.plant() for problem in self.problems]

    def floor_of(self, rows: Sequence[Floats]) -> Floats:
        """(12,) the floor, at most the error itself (m, 12): flights may be quieter than those that the noise is of."""
        return np.minimum(self.floor, np.sqrt(np.mean(np.vstack(rows) ** 2, axis=0)))

    def density(self, frequency: Floats) -> Floats:
        """(12, f) two-sided power density of each channel, behind its filters, at frequencies above 0, Hz."""
        return self._density(frequency, () if self.slow else (SLOW,))

    def variances(self) -> Floats:
        """(12,) of white noise at the residuals' rate that is as dense as each channel's below the cutoff."""
        return np.asarray(self.floor**2 * self.rate / (2 * self.segments[0].filters.cutoff))

    def _level(self, without: Collection[str]) -> Floats:
        """Root of the integral from half a wave in a segment to the filters' end: what is slower is a sensor's bias."""
        seconds = float(np.median([segment.duration for segment in self.segments]))
        frequency = np.arange(0.5, self.rate / 2 * seconds) / seconds
        return np.asarray(np.sqrt(2 * self._density(frequency, without).sum(axis=1) / seconds))

    def _density(self, frequency: Floats, without: Collection[str]) -> Floats:
        total, rows = np.zeros((channels.CHANNELS, len(frequency))), 0
        for problem, plant, fit in zip(self.problems, self._plants, self.fits, strict=True):
            count, segment = sum(map(len, problem.flights)), problem.flights[0].segment
            passed = _low_pass_gain(segment.rate, segment.filters.cutoff, frequency) ** 2
            total += count * passed * channel_density(plant, fit, frequency, without)
            rows += count
        return total / rows


def channel_density(plant: Plant, fit: NoiseFit, frequency: Floats, without: Collection[str] = ()) -> Floats:
    """(12, f) two-sided power density of the residual channels at frequencies above 0, Hz, before their filters.

    without: names of components that are left out.
    """
    rest = Composition(tuple(one for one in fit.composition.components if one.name not in without))
    readings = combined(rest.model(fit.values, plant.conditions), plant)
    return readings.density_of(_operator(plant, frequency), frequency, plant.conditions.period).T


def _operator(plant: Plant, frequency: Floats) -> Complex:
    """(f, 12, m): the residual channels of the readings, about hover."""
    first = {kind: place for place, kind in reversed([*enumerate(o.rpartition("_")[0] for o in plant.outputs)])}
    operator = np.zeros((len(frequency), channels.CHANNELS, len(plant.outputs)), dtype=complex)
    derivative, one = 2j * np.pi * frequency[:, None, None] * np.eye(3), np.eye(3)

    def add(channel: slice, kind: str, block: Floats | Complex) -> None:
        operator[:, channel, first[kind] : first[kind] + 3] += block

    predicted = np.zeros((6, len(plant.outputs)))  # specific force and angular acceleration by the readings
    for place, kind in enumerate(("velocity", "attitude", "gyro")):
        if kind in first:
            predicted[:, first[kind] : first[kind] + 3] = plant.slope[:, 3 * place : 3 * place + 3]
    if "rotor_speed" in first:
        predicted[:, first["rotor_speed"] :] = plant.by_rotor
    if "accelerometer" in first:
        add(channels.SPECIFIC_FORCE, "accelerometer", one)
        operator[:, channels.SPECIFIC_FORCE] -= predicted[:3]
    if "velocity" in first:
        add(channels.POSE_ACCELERATION, "velocity", derivative)
        operator[:, channels.POSE_ACCELERATION] -= predicted[:3]
        if "attitude" in first:
            add(channels.POSE_ACCELERATION, "attitude", skew(plant.conditions.specific_force))
    if "gyro" in first:
        add(channels.ANGULAR_ACCELERATION, "gyro", derivative)
        if "attitude" in first:
            add(channels.ATTITUDE_RATE, "attitude", derivative)
            add(channels.ATTITUDE_RATE, "gyro", -one)
    else:
        add(channels.ANGULAR_ACCELERATION, "attitude", derivative @ derivative)
    operator[:, channels.ANGULAR_ACCELERATION] -= predicted[3:]
    return operator


def _low_pass_gain(rate: float, cutoff: float, frequency: Floats) -> Floats:
    """Gain of the residuals' low-pass at frequencies, Hz."""
    impulse = np.zeros(2 * round(rate) + 1)
    impulse[len(impulse) // 2] = 1.0
    gain = np.abs(np.fft.rfft(zero_phase(impulse, rate, cutoff)))
    return np.asarray(np.interp(frequency, np.fft.rfftfreq(len(impulse), 1 / rate), gain))
