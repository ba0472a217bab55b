"""Lines in the spectrum of a force or torque, as the innovations show them.

A disturbance u of frequency f makes whitened innovations H(f) u, with the stationary filter's response H. The score of
its amplitude is H' W, W the innovations' Fourier transform, and its information N |H|^2 / 2 for each of cosine and
sine: a matched filter at each frequency. A line has a phase of its own in each flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from diagnosis.likelihood import priors
from diagnosis.likelihood.columns import over_rows
from diagnosis.likelihood.flight_rows import FlightRows
from diagnosis.likelihood.gain import Gain
from diagnosis.likelihood.innovations import start
from diagnosis.likelihood.problem import Problem, data
from dynamics.arrays import Floats

CHANNELS = 6  # specific force x, y, z and angular acceleration x, y, z
FINE = 4  # frequencies tried for each that a flight tells apart


@dataclass(frozen=True)
class LineAt:
    """A line of a channel. log_odds: against none, or one as slight as every model leaves. tried: lines in all."""

    channel: int
    frequency: float
    log_odds: float
    tried: float


def strongest_lines(problem: Problem, gain: Gain, usual: Sequence[float]) -> list[LineAt]:
    """The strongest line of each channel whose odds are enough. usual: motion of each channel, m/s^2 and rad/s^2."""
    t = problem.thresholds
    flights = [(rows, problem.along(place)) for place, rows in enumerate(problem.flights)]
    burnt = [int(t.burn_in / rows.period) for rows, _ in flights]
    longest = max(len(rows) - first for (rows, _), first in zip(flights, burnt, strict=True))
    period = flights[0][0].period
    count = FINE * longest
    frequency = np.asarray(np.fft.rfftfreq(count, period), dtype=np.float64)
    there = (frequency > t.line_turns / (longest * period)) & (frequency < t.line_highest / period)
    if not there.any():
        return []
    response = _response(flights[0][0], gain, frequency[there])
    sizes = np.array([priors.DISCREPANCY, *priors.SIZES])
    evidence = np.zeros((CHANNELS, len(sizes), int(there.sum())))
    power = np.sum(np.abs(response) ** 2, axis=2)  # (6, f)
    gains, rows_of = [], []
    for (_, along), first in zip(flights, burnt, strict=True):
        white, _ = start(gain, 1).advance(along.model, *data(along))
        waves = np.fft.rfft(white[first:, :, 0], count, axis=0)[there]
        rows_of.append(len(white) - first)
        gains.append(np.abs(np.einsum("cfm,fm->cf", response.conj(), waves)) ** 2 / power / rows_of[-1])
    louder = _over_white(np.array(gains), FINE * t.line_surroundings)
    for score, rows in zip(gains, rows_of, strict=True):
        for place, size in enumerate(sizes):
            ratio = rows * power / 2 * (size * np.asarray(usual)[:, None]) ** 2 / louder
            evidence[:, place] += score / louder * ratio / (1 + ratio) - np.log1p(ratio)
    gained = evidence[:, 1:].max(1) - np.maximum(evidence[:, 0], 0.0)
    tried = float(CHANNELS * there.sum() / FINE * len(priors.SIZES))
    best = gained.argmax(1)
    odds = gained.max(1) - np.log(tried)
    lines = [LineAt(c, float(frequency[there][i]), float(odds[c]), tried) for c, i in enumerate(best)]
    return [line for line in lines if line.log_odds >= t.named]


def _over_white(gains: Floats, width: int) -> Floats:
    """(6, f) power of innovations about each frequency over that of white ones, at least one: the noise's model is not
    right to the last digit either. gains: (flights, 6, f), of white innovations exponential with a mean of one."""
    total, white = gains.sum(0), len(gains) - 1 / 3  # near the median of such a sum
    around = scipy.ndimage.median_filter(total, size=(1, width), mode="nearest")
    return np.asarray(np.maximum(around / white, 1.0))


def _response(rows: FlightRows, gain: Gain, frequency: Floats) -> NDArray[np.complex128]:
    """(6, f, m) whitened innovations by a unit of each channel."""
    acting = np.zeros((len(rows), 6, CHANNELS))
    acting[:, range(CHANNELS), range(CHANNELS)] = 1.0
    readings = np.zeros((len(rows), 12 + rows.rotor_speed(None).shape[1], CHANNELS))
    readings[:, 9:12] = acting[:, :3]
    B, D = (x[len(rows) // 2] for x in over_rows(rows, acting, readings))
    into = np.zeros((len(gain.transition), CHANNELS))
    into[: len(B)] = B
    values, vectors = np.linalg.eig(gain.transition - gain.K @ gain.model.C)
    driven = np.linalg.solve(vectors, into - gain.K @ D)
    turning = np.exp(2j * np.pi * frequency * rows.period)
    moved = driven[None] / (turning[:, None, None] - values[None, :, None])
    shown = gain.whitening @ gain.model.C @ vectors @ moved + gain.whitening @ D
    return np.ascontiguousarray(shown.transpose(2, 0, 1))
