"""Segments of flights as rows for the filter: what was read in a row is its mean over the row's period."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from diagnosis.data.segment import Segment
from diagnosis.thresholds import DEFAULT, LikelihoodThresholds
from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.rotation_matrix import exponential, logarithm

MAX_SAVED = 12  # lags whose speeds are saved
LAG_STEP = 0.01  # relative, for the slope in a lag


@dataclass(frozen=True, eq=False)
class Reference:
    """A trajectory about which the model is linear, at the rows' ends: N + 1 instants.

    velocity: world, m/s. rotation: (N + 1, 3, 3) body to world. rate: body, rad/s.
    rotors: (N + 1, 2 rotors) speeds, rad/s, and their slopes, rad/s^2; (N + 1, 0) where they are commanded.
    """

    velocity: Floats
    rotation: Floats
    rate: Floats
    rotors: Floats


@dataclass(frozen=True, eq=False)
class FlightRows:
    """N rows of a segment.

    period: s. readings: kinds that were logged. before: the part of the same segment that ends where it begins.
    velocity (N, 3) world, rotation (N, 3, 3), rate (N, 3), force (N, 3), position (N, 3), environment (N, 2).
    """

    segment: Segment
    group: int
    merged: int
    period: float
    readings: tuple[str, ...]
    velocity: Floats
    rotation: Floats
    rate: Floats
    force: Floats
    position: Floats
    environment: Floats
    before: FlightRows | None = None
    _speeds: dict[float | None, Floats] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.velocity)

    @property
    def kind(self) -> tuple[object, ...]:
        """Of logs that have readings of the same sensors at about the same rate."""
        return self.readings, round(1 / self.period), self.segment.rotor_source, self.segment.pose_source

    def rotor_speed(self, lag: float | None) -> Floats:
        """(N, rotors) rad/s behind a lag, s: their squares have the rows' mean."""
        if lag not in self._speeds:
            if len(self._speeds) >= MAX_SAVED:
                self._speeds.clear()
            speed = self._centred() if lag is None else self._lagged(lag)
            self._speeds[lag] = np.sqrt(_merged(speed**2, self.merged))
        return self._speeds[lag]

    def slope_in_lag(self, lag: float) -> Floats:
        """(N, rotors) rad/s^2 of `rotor_speed`."""
        low, high = (self.rotor_speed(lag * (1 + step)) for step in (-LAG_STEP, LAG_STEP))
        return np.asarray((high - low) / (2 * LAG_STEP * lag))

    def measured_reference(self) -> Reference:
        """The trajectory of the readings themselves."""
        turn = logarithm(np.swapaxes(self.rotation[:-1], 1, 2) @ self.rotation[1:]) / 2
        inner = self.rotation[:-1] @ exponential(turn)
        first, last = self.rotation[0] @ exponential(-turn[0]), self.rotation[-1] @ exponential(turn[-1])
        rotors = np.zeros((len(self) + 1, 0))
        if "rotor_speed" in self.readings:
            speed = self.rotor_speed(None)
            rotors = np.concatenate([_ends(speed), _ends(np.gradient(speed, self.period, axis=0))], axis=1)
        rotation = np.concatenate([first[None], inner, last[None]])
        return Reference(_ends(self.velocity), rotation, _ends(self.rate), rotors)

    def _centred(self) -> Floats:
        """Speeds of the periods about the log's rows, from those at the rows."""
        raw, share = self.segment.rotor_speed, self.segment.rotor_share
        if share is None or share == 0.5:
            return raw
        weight, moved = abs(0.5 - share), np.empty_like(raw)
        if share < 0.5:
            moved[0], moved[1:] = raw[0], raw[:-1]
        else:
            moved[-1], moved[:-1] = raw[-1], raw[1:]
        return np.asarray((1 - weight) * raw + weight * moved)

    def _lagged(self, lag: float) -> Floats:
        """First-order response, exact for inputs that are lines between rows, or held."""
        raw, share, dt = self.segment.rotor_speed, self.segment.rotor_share, 1 / self.segment.rate
        decay = np.exp(-dt / lag)
        if share is None:
            later = 1 - lag / dt * (1 - decay)
            weights = np.array([later, 1 - decay - later])
        else:
            weights = (1 - decay) * np.array([share, 1 - share])
        zi = scipy.signal.lfilter_zi(weights, [1, -decay])[:, None] * raw[:1]
        return np.asarray(scipy.signal.lfilter(weights, [1, -decay], raw, axis=0, zi=zi)[0])


def make_rows(segment: Segment, group: int, thresholds: LikelihoodThresholds = DEFAULT.likelihood) -> FlightRows:
    """The rows of a segment. group: number of its flight."""
    merged = max(1, round(segment.rate / thresholds.row_rate))
    readings = [*(["velocity"] if segment.has_pose else []), *(["attitude"] if segment.has_attitude else [])]
    readings += ["gyro"] if segment.gyro is not None else []
    readings += ["accelerometer"] if segment.specific_force is not None else []
    readings += ["rotor_speed"] if segment.rotor_source == "measured" else []
    steady = np.sign(np.cumprod(np.sign(np.sum(segment.attitude[1:] * segment.attitude[:-1], axis=1))))
    attitude = segment.attitude * np.concatenate([[1.0], steady])[:, None]
    attitude = _merged(attitude, merged)
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    absent = np.zeros((len(segment), 3))
    return FlightRows(
        segment,
        group,
        merged,
        merged / segment.rate,
        tuple(readings),
        _merged(segment.velocity, merged),
        np.asarray(quaternion.rotation_matrix(attitude)),
        _merged(segment.body_rate, merged),
        _merged(absent if segment.specific_force is None else segment.specific_force, merged),
        _merged(segment.position, merged),
        _merged(segment.environment, merged),
    )


def rows_by_kind(
    segments: Sequence[Segment], groups: Sequence[int], thresholds: LikelihoodThresholds = DEFAULT.likelihood
) -> list[list[FlightRows]]:
    """The rows of segments of each kind of logs, in pieces, of which all columns fit into memory.

    groups: numbers of their flights.
    """
    kinds = dict[tuple[object, ...], list[FlightRows]]()
    for segment, group in zip(segments, groups, strict=True):
        count = math.ceil(segment.duration / thresholds.seconds)
        ends = [round(i * len(segment) / count) for i in range(count + 1)]
        made = [make_rows(segment.between(begin, end), group, thresholds) for begin, end in itertools.pairwise(ends)]
        followed = [replace(after, before=last) for last, after in itertools.pairwise(made)]
        kinds.setdefault(made[0].kind, []).extend([made[0], *followed])
    return list(kinds.values())


def _merged(values: Floats, count: int) -> Floats:
    """Means of `count` rows each."""
    if count == 1:
        return np.asarray(values, float)
    count_of_rows = len(values) // count
    return np.asarray(values[: count_of_rows * count].reshape(count_of_rows, count, *values.shape[1:]).mean(axis=1))


def _ends(values: Floats) -> Floats:
    """(N + 1, ...) values between rows, and a line's at both ends."""
    inner = (values[:-1] + values[1:]) / 2
    return np.concatenate([[1.5 * values[0] - 0.5 * values[1]], inner, [1.5 * values[-1] - 0.5 * values[-2]]])
