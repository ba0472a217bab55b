"""Ranges of motor commands, by the autopilot's parameters and else by the commands themselves.

A command's numbers do not say their range: 1300 is 0.3 of a pulse of 1000 to 2000 us, and 0.65 of a DShot command of
0 to 1999. What lies outside of a range and moves refutes it. Where several remain, the thrust tells them apart: it goes
with the command's power of one to two, counted from the range's lower end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from flights.agreement import AGREEMENT
from flights.movement import moves

MAX_BELOW, MAX_ABOVE = 0.12, 0.03  # of the span, by which moving values may lie outside: idle, rounding
EXPONENTS = (0.75, 2.6)  # of thrust in the command, of motors that are linear in it, quadratic, and the measurement
_BLOCK = 0.2  # s over which thrust and command are averaged: motors lag by less
_MIN_BLOCKS = 20
_MIN_CHANGE = 0.05  # standard deviation of the thrust's logarithm that tells its exponent
_MIN_THRUST = 2.0  # m/s^2 below which a vehicle falls, or stands and slides
_MIN_EXCESS = 0.5  # m/s^2 by which the force must differ from the weight's
_MAX_LEVEL = 1.02  # of the largest number that is still a command of 0 to 1


@dataclass(frozen=True)
class CommandRange:
    """The numbers of a motor command at rest and at full thrust.

    name: for people.
    low, high: (k,), of each motor.
    basis: on which it rests.
    """

    name: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    basis: str

    @classmethod
    def of(cls, name: str, low: float, high: float, count: int, basis: str = "") -> CommandRange:
        """One range for all motors."""
        return cls(name, (low,) * count, (high,) * count, basis)

    def scaled(self, values: Floats) -> Floats:
        """Commands of 0 to 1 of values (n, k)."""
        return np.clip(self.unlimited(values), 0.0, 1.0)

    def unlimited(self, values: Floats) -> Floats:
        """Commands of values (n, k), also beyond 0 and 1."""
        low, high = np.array(self.low), np.array(self.high)
        return np.asarray((values - low) / (high - low))

    def holds(self, values: Floats) -> bool:
        """Whether nothing moves outside of the range, and the largest value lies within it. values: (n, k)."""
        top = float(np.nanmax(values, initial=-np.inf))
        if not any(low - MAX_BELOW * (high - low) <= top for low, high in zip(self.low, self.high, strict=True)):
            return False
        for column, low, high in zip(values.T, self.low, self.high, strict=True):
            span = high - low
            outside = (column < low - MAX_BELOW * span) | (column > high + MAX_ABOVE * span)
            if not span > 0 or moves(column[outside]):
                return False
        return True

    def __str__(self) -> str:
        low, high = (_one_or_span(ends) for ends in (self.low, self.high))
        return f"{self.name} from {low} to {high}, by {self.basis}"


def _one_or_span(values: Sequence[float]) -> str:
    if max(values) == min(values):
        return f"{values[0]:g}"
    return " / ".join(f"{value:g}" for value in values)


@dataclass(frozen=True, eq=False)
class Thrust:
    """Specific force along body z, which the rotors' thrust makes. time: (n,) s. force: (n,) m/s^2."""

    time: Floats
    force: Floats


LEVELS = ("commands", 0.0, 1.0)
ONESHOT = ("OneShot125 pulses", 125.0, 250.0)
PULSES = ("pulses", 1000.0, 2000.0)
PX4_DSHOT = ("DShot commands", 0.0, 1999.0)
DSHOT = ("DShot commands", 48.0, 2047.0)
UAVCAN = ("UAVCAN raw commands", 0.0, 8191.0)
PX4_KINDS = (LEVELS, PULSES, PX4_DSHOT, UAVCAN)
ALL_KINDS = (LEVELS, ONESHOT, PULSES, PX4_DSHOT, DSHOT, UAVCAN)


def infer_range(
    time: Floats,
    values: Floats,
    stated: Sequence[CommandRange],
    kinds: Sequence[tuple[str, float, float]] = ALL_KINDS,
    thrust: Thrust | None = None,
) -> CommandRange | None:
    """The range of commands, None where they are in none that is known.

    time: (n,) s. values: (n, k). stated: by the autopilot's parameters, the likeliest first.
    kinds: ranges that this source writes, the usual one first, for numbers that no stated range holds.
    """
    count = values.shape[1]
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    top = float(np.max(np.abs(finite)))
    if top <= _MAX_LEVEL and LEVELS in kinds:
        return CommandRange.of(*LEVELS, count, "the numbers themselves")
    holding = [candidate for candidate in stated if candidate.holds(values)]
    others = [CommandRange.of(*kind, count) for kind in _possible(values, top, kinds)]
    others = [other for other in others if not any(_same(other, held) for held in holding)]
    candidates = [*holding, *others]
    if not candidates:
        return None
    powers = [None] * len(candidates) if thrust is None else _powers(time, values, candidates, thrust)
    fitting = [i for i, power in enumerate(powers) if power is not None and EXPONENTS[0] <= power <= EXPONENTS[1]]
    first = candidates[0]
    if fitting and 0 not in fitting and powers[0] is not None:
        best, power = candidates[fitting[0]], powers[fitting[0]]
        return replace(
            best,
            basis=f"the thrust, which goes with the power {power:.1f} of the command counted from {best.low[0]:g}, and "
            f"{powers[0]:.1f} if counted from {first.low[0]:g}",
        )
    if first.basis:
        return first
    basis = f"the numbers, which reach {top:.5g}"
    if 0 in fitting:
        basis += f", and the thrust, which goes with the power {powers[0]:.1f} of the command"
    others = [one for i, one in enumerate(candidates) if i and not _near(one, first) and (i in fitting or not fitting)]
    rest = " or ".join(f"{one.name} from {one.low[0]:g} to {one.high[0]:g}" for one in others)
    return replace(first, basis=f"{basis}; {rest} would fit as well" if rest else basis)


def _possible(values: Floats, top: float, kinds: Sequence[tuple[str, float, float]]) -> list[tuple[str, float, float]]:
    """Kinds of ranges that hold the values and of which they use a fair part, those that are used most first."""
    count = values.shape[1]
    possible = [kind for kind in kinds if kind != LEVELS and CommandRange.of(*kind, count).holds(values)]
    # a command that flies uses a fifth of its range at its largest: hover takes a twentieth of the thrust or more
    return [(name, low, high) for name, low, high in possible if top >= low + 0.2 * (high - low)]


def _same(one: CommandRange, other: CommandRange) -> bool:
    return one.low == other.low and one.high == other.high


def _near(one: CommandRange, other: CommandRange) -> bool:
    """Whether two ranges give nearly the same commands."""
    span = other.high[0] - other.low[0]
    return abs(one.low[0] - other.low[0]) < 0.05 * span and abs(one.high[0] - other.high[0]) < 0.05 * span


def _powers(time: Floats, values: Floats, candidates: Sequence[CommandRange], thrust: Thrust) -> list[float | None]:
    """Power of the command with which the thrust goes, by each candidate; None where the thrust hardly changes.

    On the ground the accelerometer reads the weight whatever the motors do, so that only rows count in which it reads
    another force.
    """
    start, end = max(time[0], thrust.time[0]), min(time[-1], thrust.time[-1])
    blocks = int((end - start) / _BLOCK) if end > start else 0
    if blocks < _MIN_BLOCKS:
        return [None] * len(candidates)
    edges = start + _BLOCK * np.arange(blocks + 1)
    force = _block_means(thrust.time, thrust.force, edges)
    flying = (force > _MIN_THRUST) & (np.abs(force - GRAVITY) > _MIN_EXCESS)
    powers: list[float | None] = []
    for candidate in candidates:
        level = _block_means(time, np.mean(candidate.unlimited(values), axis=1), edges)
        rows = flying & np.isfinite(level) & (level > 0.0)
        x, y = (np.log(signal[rows]) for signal in (level, force))
        if len(x) < _MIN_BLOCKS or np.std(y) < _MIN_CHANGE or np.std(x) == 0.0:
            powers.append(None)
            continue
        x, y = x - np.mean(x), y - np.mean(y)
        agreeing = float(x @ y) / float(np.sqrt((x @ x) * (y @ y)))
        powers.append(float(x @ y / (x @ x)) if agreeing > AGREEMENT else None)
    return powers


def _block_means(time: Floats, values: Floats, edges: Floats) -> Floats:
    """(len(edges) - 1,) mean of values (n,) between edges, NaN where there is none."""
    valid = np.isfinite(values)
    index = np.searchsorted(edges, time[valid], side="right") - 1
    inside = (index >= 0) & (index < len(edges) - 1)
    sums = np.bincount(index[inside], values[valid][inside], minlength=len(edges) - 1)
    counts = np.bincount(index[inside], minlength=len(edges) - 1)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
