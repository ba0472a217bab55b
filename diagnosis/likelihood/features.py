"""Discrepancies: a force or torque that no effect of the catalogue is, a smooth function of state, place or time.

A Gaussian process by random Fourier features (Rahimi and Recht, Random features for large-scale kernel machines, 2007):
sums of cosines in random directions of the scaled quantities. Or a line in the spectrum, with a phase of its own in
each flight.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.likelihood.flight_rows import FlightRows
from diagnosis.likelihood.rigid_body import Along
from dynamics.arrays import Floats

STILL = 1e-6  # deviation of a quantity over its mean, below which it does not move


@dataclass(frozen=True, eq=False)
class Smooth:
    """Smooth functions of one kind of quantity, with a mean of zero over the flights.

    mean, scale: (d,) of the quantities. directions: (d, j). phase, middle: (j,). begins: s, of each flight.
    spread: root of the functions' summed variances over the flights.
    """

    kind: str
    begins: Mapping[int, float]
    mean: Floats
    scale: Floats
    directions: Floats
    phase: Floats
    middle: Floats
    spread: float

    def __len__(self) -> int:
        return len(self.phase)

    @property
    def shares(self) -> Floats:
        """(j,) deviations of the coefficients with which all of it has a deviation of one."""
        return np.full(len(self), 1 / self.spread)

    def along(self, rows: FlightRows, along: Along) -> Floats:
        """(N, j) along a flight."""
        scaled = (QUANTITIES[self.kind](rows, along, self.begins) - self.mean) / self.scale
        return np.asarray(np.cos(scaled @ self.directions + self.phase) - self.middle)


@dataclass(frozen=True, eq=False)
class Line:
    """Cosine and sine of one frequency, Hz, in each of some flights."""

    frequency: float
    groups: tuple[int, ...]
    kind: str = "line"

    def __len__(self) -> int:
        return 2 * len(self.groups)

    @property
    def shares(self) -> Floats:
        """(j,) deviations of the coefficients with which all of it has a deviation of one."""
        return np.ones(len(self))

    def along(self, rows: FlightRows, _: Along) -> Floats:
        """(N, j) along a flight, zero in the columns of others."""
        made, turns = np.zeros((len(rows), len(self))), 2 * np.pi * self.frequency * time_of(rows)
        first = 2 * self.groups.index(rows.group)
        made[:, first], made[:, first + 1] = np.cos(turns), np.sin(turns)
        return made


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """A force or torque by some functions.

    channel: of specific force x, y, z and angular acceleration x, y, z, in body axes; of a force by place in the
    world's. deviation: of all of it, m/s^2 or rad/s^2. tried: models of its kind, one of which it is.
    """

    of: Smooth | Line
    channel: int
    deviation: float
    tried: float = 1.0

    def __len__(self) -> int:
        return len(self.of)

    @property
    def log_prior(self) -> float:
        """Log of the share of the odds against none that each of the models tried has."""
        return -float(np.log(self.tried))

    @property
    def deviations(self) -> Floats:
        """(j,) of the coefficients."""
        return self.deviation * self.of.shares

    def act(self, acting: Floats, values: Floats, along: Along) -> None:
        """Set specific force and angular acceleration (N, 6, j) by unit coefficients. values: (N, j) of functions."""
        if self.of.kind == "place" and self.channel < 3:
            acting[:, :3] = along.rotation[:, self.channel][:, :, None] * values[:, None]
        else:
            acting[:, self.channel] = values


def time_of(rows: FlightRows) -> Floats:
    """(N,) s in the log's time, of the rows' middles."""
    return np.asarray(rows.segment.start + rows.period * (np.arange(len(rows)) + 0.5))


Begins = Mapping[int, float]


def _state(rows: FlightRows, along: Along, begins: Begins) -> Floats:
    return np.hstack([_velocity(rows, along, begins), along.rate, along.speed**2, along.rotation[:, 2, :]])


def _velocity(_: FlightRows, along: Along, __: Begins) -> Floats:
    return np.asarray(np.einsum("tji,tj->ti", along.rotation, along.velocity))


def _place(rows: FlightRows, _: Along, __: Begins) -> Floats:
    return rows.position


def _time(rows: FlightRows, _: Along, begins: Begins) -> Floats:
    return np.asarray((time_of(rows) - begins[rows.group])[:, None])


QUANTITIES: Mapping[str, Callable[[FlightRows, Along, Begins], Floats]] = {
    "state": _state,
    "velocity": _velocity,
    "place": _place,
    "time": _time,
}


def smooth(
    kind: str, flights: Sequence[tuple[FlightRows, Along]], *, fineness: float, count: int, seed: int
) -> Smooth | None:
    """Functions of a kind of quantity along flights, None where nothing of it moves. fineness: of a direction, over the
    quantities' deviations."""
    begins = dict[int, float]()
    for rows, _ in flights:
        begins[rows.group] = min(begins.get(rows.group, np.inf), rows.segment.start)
    values = np.concatenate([QUANTITIES[kind](*flight, begins) for flight in flights])
    mean, scale = values.mean(0), values.std(0)
    moves = scale > STILL * (1 + np.abs(mean))
    if not moves.any():
        return None
    random = np.random.default_rng(seed)
    directions = fineness * random.standard_normal((len(mean), count)) * moves[:, None]
    phase = random.uniform(0, 2 * np.pi, count)
    scale = np.where(moves, scale, 1.0)
    waves = np.cos((values - mean) / scale @ directions + phase)
    spread = float(np.sqrt(waves.var(0).sum()))
    if spread < STILL:
        return None
    return Smooth(kind, begins, mean, scale, directions, phase, waves.mean(0), spread)
