"""How rotor speeds and commands go on between two rows of a log: smoothly, or in steps that a controller makes.

A controller that is no faster than the log holds its command from one row to the next. A rotor then settles within the
period, s(t) = u + (s_0 - u) exp(-t / tau), and its mean speed is (1 - a) s_0 + a s_1 with a from 1/2 (a slow rotor) to
1 (one that is there at once), whatever the step; speeds that hold from their row on have a = 0. What moves the
vehicle between two rows is that mean, what an accelerometer reads is the speed at its instant. Read as smooth, the
moments are (a - 1/2) periods early, which looks like damping, rotors' inertia and lag.

Which of both holds is asked of the rotation about roll and pitch, with everything else that may turn the vehicle freed:
smooth speeds have a = 1/2, and speeds that are late by their clock are late in the accelerometer's thrust, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.data.command_curve import NominalWrench
from diagnosis.data.filters import difference, simpson, slow
from diagnosis.data.segment import Segment
from diagnosis.thresholds import DEFAULT, RotorHoldThresholds
from dynamics.arrays import Floats
from dynamics.state import RATE, VELOCITY
from dynamics.vehicle import Vehicle

TURNED = (0, 1)  # axes about which rotors turn the vehicle by thrust; about z their acceleration does as well


@dataclass(frozen=True)
class RotorHold:
    """Rotor speeds that do not change smoothly between rows.

    share: of the later row in the mean speed between two rows.
    std: of it.
    period: between two rows, s.
    """

    share: float
    std: float
    period: float

    def applied(self, segment: Segment) -> Segment:
        """The segment read so."""
        return replace(segment, rotor_share=self.share)

    def note(self) -> str:
        """Note for the user."""
        late = 1e3 * (self.share - 0.5) * self.period
        return (
            f"rotor speeds are read as held or settling between rows: the mean between two rows is {self.share:.2f} "
            f"+- {1.96 * self.std:.2f} of the later one, {late:+.2f} ms from a straight line. The controller is likely "
            "no faster than the log"
        )


def find_hold(
    segments: Sequence[Segment], vehicle: Vehicle, limits: RotorHoldThresholds = DEFAULT.rotor_hold
) -> RotorHold | None:
    """How measured speeds go on between rows; None where they are smooth, or these flights do not clearly show it."""
    if segments[0].rotor_source != "measured":
        return None
    nominal = NominalWrench(vehicle)
    turned = [_Delay.of([_rotation(s, nominal, vehicle, axis) for s in segments], limits) for axis in TURNED]
    rows = _Delay.joined([one for one in turned if one is not None])
    if rows is None or rows.deviations < limits.deviations:
        return None
    thrust = None
    if all(s.specific_force is not None for s in segments):
        thrust = _Delay.of([_vertical(s, nominal) for s in segments], limits)
    if thrust is not None and _is_late(rows, thrust, limits):
        return None
    late, std = rows.best
    share = 0.5 + late
    if not -limits.slack * std <= share <= 1 + limits.slack * std:
        return None
    return RotorHold(float(np.clip(share, 0.0, 1.0)), std, 1 / segments[0].rate)


def _is_late(rotation: _Delay, thrust: _Delay, limits: RotorHoldThresholds) -> bool:
    """Whether one delay of rotation and thrust is likelier than speeds that are late in the rotation alone."""
    both, _ = _mean([rotation.rows, thrust.rows], [rotation.std, thrust.std])
    one_clock = ((rotation.rows - both) / rotation.std) ** 2 + ((thrust.rows - both) / thrust.std) ** 2
    return (thrust.rows / thrust.std) ** 2 > one_clock + limits.min_gain


@dataclass(frozen=True, eq=False)
class _Rows:
    """One axis of a segment: y is explained by a forcing, its change from row to row, and others beside them.

    y: (m,). forcing: (m, 2), the forcing and its change. others: (m, k). instruments: (m, 2) in place of the forcing,
    which feedback does not correlate with turbulence.
    """

    y: Floats
    forcing: Floats
    others: Floats
    instruments: Floats


@dataclass(frozen=True)
class _Delay:
    """By how many rows a forcing is late, by instruments. plain: the same by all motion, with its deviation, which is
    more precise and which feedback may bias. Deviations are of blocks: the rows' own likelihood is turbulence's."""

    rows: float
    std: float
    plain: float
    plain_std: float

    @property
    def deviations(self) -> float:
        """From none: the root of Wald's statistic."""
        rows, std = self.best
        return abs(rows) / std

    @property
    def best(self) -> tuple[float, float]:
        """Rows and their deviation: by all motion where that agrees with the instruments (Hausman, 1978)."""
        chance = np.sqrt(max(self.std**2 - self.plain_std**2, 0.0))
        if self.plain_std < self.std and abs(self.plain - self.rows) <= 2 * chance:
            return self.plain, self.plain_std
        return self.rows, self.std

    @classmethod
    def joined(cls, delays: Sequence[_Delay]) -> _Delay | None:
        """The common one of several; None without any."""
        if not delays:
            return None
        rows, std = _mean([one.rows for one in delays], [one.std for one in delays])
        plain, plain_std = _mean([one.plain for one in delays], [one.plain_std for one in delays])
        return cls(rows, std, plain, plain_std)

    @classmethod
    def of(cls, parts: Sequence[_Rows], limits: RotorHoldThresholds) -> _Delay | None:
        """Of the segments' rows; None where the forcing acts the other way."""
        by_instruments = _estimated(parts, [part.instruments for part in parts], limits)
        plain = _estimated(parts, [part.forcing for part in parts], limits)
        if by_instruments is None or plain is None:
            return None
        return cls(*by_instruments, *plain)


def _estimated(
    parts: Sequence[_Rows], instruments: Sequence[Floats], limits: RotorHoldThresholds
) -> tuple[float, float] | None:
    """Rows by which the forcing is late, and their deviation from blocks; None where it turns nothing, or backwards."""
    y = [_centred(part.y) for part in parts]
    x = [_centred(np.hstack([part.forcing, part.others])) for part in parts]
    z = [_centred(np.hstack([own, part.others])) for own, part in zip(instruments, parts, strict=True)]
    size, scale = (np.maximum(np.sqrt(np.mean(np.vstack(of) ** 2, axis=0)), 1e-12) for of in (x, z))
    x, z = [values / size for values in x], [values / scale for values in z]
    slope = sum((b.T @ a for a, b in zip(x, z, strict=True)), np.zeros((len(size), len(size))))
    slope += limits.ridge * sum(map(len, y)) * np.eye(len(size))
    theta = np.linalg.solve(slope, sum((b.T @ c for b, c in zip(z, y, strict=True)), np.zeros(len(size))))
    errors = [b * (c - a @ theta)[:, None] for a, b, c in zip(x, z, y, strict=True)]
    scores, inverse = np.vstack([_by_block(e, limits.block_rows) for e in errors]), np.linalg.inv(slope)
    deviation = np.sqrt(np.diag(inverse @ (scores.T @ scores) @ inverse.T))
    gain, change = (theta[:2] / size[:2]).tolist()
    if not (gain > 0 and deviation[1] > 0):
        return None
    return change / gain, float(deviation[1] / size[1] / gain)


def _mean(values: Sequence[float], deviations: Sequence[float]) -> tuple[float, float]:
    """The mean of values by their deviations, and its own."""
    weights = np.array(deviations) ** -2.0
    return float(weights @ np.array(values) / weights.sum()), float(weights.sum() ** -0.5)


def _centred(values: Floats) -> Floats:
    return np.asarray(values - values.mean(axis=0))


def _by_block(values: Floats, length: int) -> Floats:
    return np.add.reduceat(values, np.arange(0, len(values), length))


def _with_change(forcing: Floats) -> Floats:
    """(n, 2) a forcing (n,), and by how much it is more when it is a row later."""
    change = np.zeros_like(forcing)
    change[1:-1] = (forcing[2:] - forcing[:-2]) / 2
    return np.column_stack([forcing, change])


def _rotation(segment: Segment, nominal: NominalWrench, vehicle: Vehicle, axis: int) -> _Rows:
    """Angular acceleration that the file's effects do not make, the rotors' moment over inertia, and others.

    Others: body rates, thrust, and what air does to the rotors, with and without a steady wind.
    """
    inertia, rate = np.array(vehicle.body.inertia), segment.body_rate
    free = np.cross(rate, inertia * rate) / inertia - nominal.of_effects(segment)[1] / inertia
    turning = difference(rate, segment.rate) + simpson(free)
    moment = segment.rotor_speed**2 @ nominal.allocation[1:].T / inertia
    slow_turning = slow(turning[:, axis], segment.rate, segment.filters.slow_cutoff)
    instruments = np.column_stack([slow_turning, np.gradient(slow_turning)])
    speeds, smooth_rate = segment.low_pass(segment.rotor_speed), segment.smooth[:, RATE]
    arms = speeds @ np.array(vehicle.rotors.position)[:, :2]
    spin = (speeds @ np.array(vehicle.rotors.spin))[:, None]
    others = [smooth_rate, nominal.thrust(segment)[:, None], _products(smooth_rate, spin)]
    if segment.has_pose:
        air = _air(segment)
        speed = np.linalg.norm(air[:, :3], axis=1)[:, None]
        others += [air, air[:, :3] * speed, _products(air, smooth_rate), _products(air, arms)]
    rows = segment.decimated
    return _Rows(
        segment.low_pass(turning[:, axis])[rows],
        segment.low_pass(simpson(_with_change(moment[:, axis])))[rows],
        segment.low_pass(np.hstack(others))[rows],
        segment.low_pass(instruments)[rows],
    )


def _vertical(segment: Segment, nominal: NominalWrench) -> _Rows:
    """Specific force along body z that the file's effects do not make, the rotors' thrust over mass, and the air."""
    assert segment.specific_force is not None
    forcing = segment.low_pass(simpson(_with_change(nominal.thrust(segment))))[segment.decimated]
    others = np.zeros((len(segment), 0))
    if segment.has_pose:
        air = _air(segment)
        others = np.hstack([air, _products(air[:, :3], air)])
    force = simpson(segment.specific_force[:, 2] - nominal.of_effects(segment)[0])
    rows = segment.decimated
    return _Rows(segment.low_pass(force)[rows], forcing, segment.low_pass(others)[rows], forcing)


def _air(segment: Segment) -> Floats:
    """(n, 9) velocity in body axes, and that of air of 1 m/s along world x and y."""
    velocity = np.einsum("nji,nj->ni", segment.to_world, segment.smooth[:, VELOCITY])
    return np.hstack([velocity, segment.to_world[:, 0], segment.to_world[:, 1]])


def _products(one: Floats, other: Floats) -> Floats:
    """(n, a b) products of the columns of both."""
    return np.asarray((one[:, :, None] * other[:, None, :]).reshape(len(one), -1))
