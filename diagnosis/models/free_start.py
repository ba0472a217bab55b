"""Where an effect's hidden states begin: a log may start in mid-motion, as with a load that swings already.

The states at a segment's start are fitted to its first seconds: Gauss-Newton on what the rotors' thrust leaves of the
measured acceleration, beside what other missing effects would leave there: a share of the thrust, drag, and a bias by
axis. An effect without strength is fitted with one of its own, so that its columns are those of a motion that occurs.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from diagnosis.data.segment import Segment
from diagnosis.data.workspace import key_of
from diagnosis.models import channels
from diagnosis.models.prediction import Prediction
from diagnosis.thresholds import DEFAULT, PredictionThresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect, Parameter
from dynamics.state import VELOCITY
from dynamics.vehicle import Vehicle

TINY = 1e-12  # instead of nothing


class FromStart(Protocol):
    """A model whose hidden states begin anywhere."""

    @property
    def named_values(self) -> Mapping[str, float]:
        """Its parameters."""
        ...

    def settled(self, segment: Segment) -> Floats:
        """(h,) its hidden states in hover."""
        ...

    def predict_from(
        self, segment: Segment, changed: Mapping[str, float], starts: Sequence[Floats]
    ) -> list[Prediction]:
        """Its predictions along a segment. starts: (h,) of the hidden states, each."""
        ...


@dataclass(frozen=True, eq=False)
class FreeStart:
    """The start of one effect's hidden states.

    effect: which it is. key: its name in a model.
    model: the vehicle with this effect alone.
    places: of the free ones among them. spread: (k,) their standard deviations about hover.
    vehicle: whose rotors they are.
    """

    effect: Effect
    key: str
    model: FromStart
    places: Sequence[int]
    spread: Floats
    vehicle: Vehicle
    thresholds: PredictionThresholds

    def of(self, segment: Segment, values: Mapping[str, float]) -> Floats:
        """(k,) the free states at a segment's start. values: of the model's parameters, by its names."""
        segment = segment.without_noise or segment
        return segment.workspace.get("start", self._case(values), lambda: self._start(segment, values))

    def _case(self, values: Mapping[str, float]) -> Hashable:
        return self.key, key_of(self.thresholds), np.array([values[name] for name in self.model.named_values]).tobytes()

    def _start(self, segment: Segment, values: Mapping[str, float]) -> Floats:
        absent = self._absent(values)
        if values != absent:
            off = self._refined(segment, values, self._nearby(segment, values))
        elif self._is_moving(segment, absent):
            off = self._settled(segment, self._of_weight(segment, absent))[0]
        else:
            off = np.zeros(len(self.places))
        return np.asarray(self.model.settled(segment)[list(self.places)] + self.spread * off)

    def _of_weight(self, segment: Segment, absent: Mapping[str, float]) -> dict[str, float]:
        """The parameters with the strength that leaves least of a segment's beginning where nothing moves.

        With the usual one where the rotors' speeds follow from commands, whose gain is fitted to the weight.
        """
        usual = self.effect.defaults(self.vehicle)
        present = {**absent, **{name: usual[p.name] for name, p in self._strengths.items()}}
        if segment.rotor_source != "measured":
            return present
        part = _first(segment, self.thresholds.free_start_durations[-1])
        hover = self.model.settled(part)
        without = self._thrust(part, absent)
        push, left = self._force(part, present, hover) - without, channels.measured(part)[:, _channel(part)] - without
        factor = float(np.clip(np.sum(push * left) / np.sum(push**2), *self.thresholds.free_start_strength))
        return {name: absent[name] + factor * (value - absent[name]) for name, value in present.items()}

    def _nearby(self, segment: Segment, values: Mapping[str, float]) -> tuple[Floats, Floats]:
        """The start with rounded parameters of the effect, and the columns there."""
        own = {
            name: _rounded(values[name], self.thresholds.free_start_rounding)
            for name in values
            if name.startswith(f"{self.key}.")
        }
        near = {**values, **own}
        return segment.workspace.get("start nearby", self._case(near), lambda: self._settled(segment, near))

    def _refined(self, segment: Segment, values: Mapping[str, float], near: tuple[Floats, Floats]) -> Floats:
        """(k,) the free states, standard deviations from hover, from a start with parameters that are near.

        Steps with the columns of that start, always as many, so that the result is smooth in the parameters.
        """
        (off, columns), part = near, _first(segment, self.thresholds.free_start_durations[-1])
        for _ in range(self.thresholds.free_start_steps):
            left = channels.measured(part)[:, _channel(part)] - self._forces_from(part, values, [off])[0]
            off = moved_start(off, posterior_step(columns, left, off), limits=self.thresholds)
        return off

    def _is_moving(self, segment: Segment, absent: Mapping[str, float]) -> bool:
        """Whether what the rotors leave of a segment's beginning is more than noise where such states are slow."""
        key = key_of(self.thresholds), self._others(absent)
        return segment.workspace.get("moves", key, lambda: self._moves(segment, absent))

    def _moves(self, segment: Segment, absent: Mapping[str, float]) -> bool:
        limits = self.thresholds
        part = _first(segment, limits.free_start_durations[-1])
        thrust = self._thrust(part, absent)
        left = channels.measured(part)[:, _channel(part)] - thrust
        columns = np.stack(_nuisances(part, thrust), axis=2).reshape(left.size, -1)
        left -= (columns @ np.linalg.lstsq(columns, left.ravel(), rcond=None)[0]).reshape(left.shape)
        frequency, power = scipy.signal.periodogram(left, part.decimated_rate, window="hann", axis=0)
        slow, fast = (
            power[(low <= frequency) & (frequency <= high)].mean(axis=0)
            for low, high in (limits.free_start_band, limits.free_start_noise_band)
        )
        return bool(np.max(slow / np.maximum(fast, TINY)) > limits.free_start_excess)

    def _absent(self, values: Mapping[str, float]) -> dict[str, float]:
        return {**values, **{name: p.neutral for name, p in self._strengths.items()}}

    def _settled(self, segment: Segment, values: Mapping[str, float]) -> tuple[Floats, Floats]:
        """(k,) the free states, standard deviations from hover, and the columns of the last step.

        Maximum a posteriori, by Gauss-Newton over ever longer beginnings.
        """
        off, columns = np.zeros(len(self.places)), np.zeros((0, 0, 0))
        for duration in self.thresholds.free_start_durations:
            part = _first(segment, duration)
            difference = self.thresholds.free_start_difference
            moved = [off, *(off + row for row in difference * np.eye(len(off)))]
            here, *others = self._forces_from(part, values, moved)
            slopes = [(force - here) / difference for force in others]
            without = self._thrust(part, self._absent(values))
            columns = np.stack([*slopes, *_nuisances(part, without)], axis=2)
            left = channels.measured(part)[:, _channel(part)] - here
            off = moved_start(off, posterior_step(columns, left, off), limits=self.thresholds)
        return off, columns

    def _forces_from(self, segment: Segment, values: Mapping[str, float], moved: Sequence[Floats]) -> list[Floats]:
        """(m, 3) of each start, (k,) standard deviations from hover."""
        starts = [self.model.settled(segment) for _ in moved]
        for start, off in zip(starts, moved, strict=True):
            start[list(self.places)] += off * self.spread
        return self._forces(segment, values, starts)

    def _force(self, segment: Segment, values: Mapping[str, float], start: Floats) -> Floats:
        return self._forces(segment, values, [start])[0]

    def _thrust(self, segment: Segment, absent: Mapping[str, float]) -> Floats:
        """(m, 3) what the rotors give without the effect, whose other parameters then do not matter."""

        def compute() -> Floats:
            return self._force(segment, absent, self.model.settled(segment))

        thrust = segment.workspace.get("thrust", self._others(absent), compute, limit=1)
        # hidden states that these logs are too slow for have no part in it elsewhere
        return thrust if np.isfinite(thrust).all() else compute()

    def _others(self, values: Mapping[str, float]) -> Hashable:
        """The parameters that are not the effect's."""
        return tuple(value for name, value in values.items() if not name.startswith(f"{self.key}."))

    def _forces(self, segment: Segment, values: Mapping[str, float], starts: Sequence[Floats]) -> list[Floats]:
        predictions, channel = self.model.predict_from(segment, values, starts), _channel(segment)
        kinds = tuple(channel.start == channels.AXES * i for i in range(len(channels.KINDS)))
        predicted = channels.predicted(segment, predictions, kinds)[:, channel]
        return [predicted[:, :, i] for i in range(len(starts))]

    @property
    def _strengths(self) -> dict[str, Parameter]:
        """The parameters in which the effect is linear, by the model's names."""
        held = (*self.effect.refine, *self.effect.assumed)
        return {f"{self.key}.{p.name}": p for p in self.effect.parameters if p.name not in held}


def _first(segment: Segment, duration: float) -> Segment:
    """Its first seconds."""
    count = round(duration * segment.rate)
    if count >= len(segment):
        return segment
    return segment.workspace.get("beginning", count, lambda: segment.between(0, count))


def _rounded(value: float, step: float) -> float:
    """A value of either sign, of a grid of logarithms."""
    return math.copysign(math.exp(step * round(math.log(abs(value)) / step)), value) if value else 0.0


def _channel(segment: Segment) -> slice:
    return channels.SPECIFIC_FORCE if channels.present(segment)[0] else channels.POSE_ACCELERATION


def _nuisances(segment: Segment, thrust: Floats) -> list[Floats]:
    """Columns (m, 3) of a bias and a drag by axis, and of the thrust's error."""
    rows = segment.decimated
    air = np.einsum("nji,nj->ni", segment.to_world[rows], segment.smooth[rows, VELOCITY])
    axes = np.eye(3)
    return [*(np.tile(axis, (len(thrust), 1)) for axis in axes), *(air * axis for axis in axes), thrust]


def moved_start(
    off: Floats, change: Floats, std: Floats | float = 1.0, limits: PredictionThresholds = DEFAULT.prediction
) -> Floats:
    """Starts after a step, as far as one may move at once and in all. off: before it, from the prior's mean. std: of
    the prior."""
    step, reach = limits.free_start_step * std, limits.free_start_reach * std
    return np.clip(off + np.clip(change, -step, step), -reach, reach)


def posterior_step(columns: Floats, left: Floats, off: Floats) -> Floats:
    """(k,) Gauss-Newton step of values that are (k,) `off` from their prior's mean, in its standard deviations.

    columns: (m, 3, k + j) of these and of j nuisances without a prior. left: (m, 3) that they explain.
    """
    a, y, count = columns.reshape(-1, columns.shape[2]), left.ravel(), len(off)
    scale = np.linalg.norm(a, axis=0) + TINY
    if not (np.isfinite(a).all() and np.isfinite(y).all()):
        return np.zeros(count)
    free = np.linalg.lstsq(a / scale, y, rcond=1e-8)[0] / scale
    noise = np.mean((y - a @ free) ** 2)
    gram, product = a.T @ a, a.T @ y
    gram += 1e-9 * np.diag(np.diag(gram)) + TINY * np.eye(len(gram))
    gram[:count, :count] += noise * np.eye(count)
    product[:count] -= noise * off
    return np.asarray(np.linalg.solve(gram, product)[:count])
