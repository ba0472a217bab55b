"""Rotor speed over motor signal, where a log holds both: speed at full signal, curve and lag."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from diagnosis.data.command_curve import lagged
from diagnosis.estimation.fitted import ParameterEstimate
from diagnosis.thresholds import DEFAULT
from dynamics.arrays import Floats
from flights import Flight

LIMITS = DEFAULT.vehicle


@dataclass(frozen=True)
class SignalFit:
    """Squared speed = speed_max^2 (curve s^2 + (1 - curve) s) of the signal s behind a lag.

    speed_max: rad/s. lag: s. Deviations are of the median over parts of the flights.
    """

    speed_max: ParameterEstimate
    curve: ParameterEstimate
    lag: ParameterEstimate


def signal_fit(flights: Sequence[Flight]) -> SignalFit | None:
    """The fit of all flights; None where one lacks speeds or signals, or too little of them is under load."""
    if not all(flight.has("rotor_speed", "rotor_command") for flight in flights):
        return None
    fits = [_fit(*part) for flight in flights for part in _parts(flight)]
    if len(fits) < 2:
        return None
    columns = np.array(fits)
    middle, spread = np.median(columns, axis=0), np.std(columns, axis=0, ddof=1) / math.sqrt(len(fits))
    speed, curve, lag = (
        ParameterEstimate(float(m), float(s), u) for m, s, u in zip(middle, spread, ("rad/s", "1", "s"), strict=True)
    )
    return SignalFit(speed, curve, lag) if speed.value > 0 and math.isfinite(speed.value) else None


def _parts(flight: Flight) -> Iterator[tuple[Floats, Floats, float]]:
    """Signal, speed and rate of each part of a flight, where the rotors carry the vehicle."""
    signal, speed = flight["rotor_command"], flight["rotor_speed"]
    finite = np.isfinite(signal).all(axis=1) & np.isfinite(speed).all(axis=1)
    loaded = finite & (np.sum(signal, axis=1) > LIMITS.min_loaded * np.nanpercentile(np.sum(signal, axis=1), 90))
    rows = np.flatnonzero(loaded)
    if len(rows) < LIMITS.signal_parts * flight.rate:
        return
    inside = slice(rows[0], rows[-1] + 1)
    for s, w, good in zip(
        *(np.array_split(a[inside], LIMITS.signal_parts) for a in (signal, speed, loaded)), strict=True
    ):
        if good.mean() > LIMITS.min_part:
            yield s[good], w[good], flight.rate


def _fit(signal: Floats, speed: Floats, rate: float) -> tuple[float, float, float]:
    """(speed at full signal, curve, lag) of one part."""
    best = (math.inf, 0.0, 0.0, 0.0)
    for lag in np.arange(0.0, LIMITS.max_lag + LIMITS.lag_step / 2, LIMITS.lag_step):
        x = lagged(signal, rate, float(lag))[round(rate / 2) :].ravel()
        y = (speed[round(rate / 2) :] ** 2).ravel()
        scale = float(np.mean(y))
        solved = scipy.optimize.lsq_linear(np.column_stack([x**2, x]), y / scale, bounds=(0, np.inf))
        full = float(np.sum(solved.x)) * scale
        best = min(best, (float(solved.cost), math.sqrt(full), float(solved.x[0]) * scale / full, float(lag)))
    return best[1:]
