"""The effects that might be missing, linearised about the present model.

Columns come from the effects' own expressions. An effect that is linear in some of its parameters gives one column
for each of them and is tried on a grid of the others; an effect whose parameters are all held gives one column, a
fixed shape: the difference that it makes. An effect that the vehicle file names already is a candidate for a
correction: what is sought is the difference that other values make.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.selection.visibility import can_show
from diagnosis.thresholds import DEFAULT, PredictionThresholds
from dynamics.effect import Effect, Span
from dynamics.vehicle import EffectUse, Vehicle

Identity = tuple[str, int | None]  # an effect's name and its rotor


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at one point of its grid.

    effect: of the catalogue.
    rotor: that it acts on, if it is an effect of one rotor.
    at: values about which it is linear, of all parameters.
    free: parameters in which it is linear, and whose values are sought.
    present: values in the vehicle file, where it names the effect; without them the effect is absent.
    """

    effect: Effect
    rotor: int | None
    at: Mapping[str, float]
    free: tuple[str, ...]
    present: Mapping[str, float] | None = None

    @property
    def fixed_shape(self) -> bool:
        """Whether all its parameters are held."""
        return not self.free

    @property
    def sizes(self) -> dict[str, float]:
        """Where it is linear, less the values in the present model: those of the file, or where the effect vanishes."""
        neutral = {p.name: p.neutral for p in self.effect.parameters}
        present = neutral if self.present is None else self.present
        return {name: value - present[name] for name, value in self.at.items()}

    @property
    def key(self) -> str:
        """Name in a model."""
        return self.effect.name if self.rotor is None else f"{self.effect.name}[{self.rotor}]"

    @property
    def identity(self) -> Identity:
        """Name and rotor, as in a vehicle file."""
        return self.effect.name, self.rotor

    @property
    def values(self) -> dict[str, float]:
        """The values about which it is linear, by the model's names."""
        return {f"{self.key}.{name}": value for name, value in self.use().parameters.items()}

    def distance(self, values: Mapping[str, float]) -> float:
        """How far the values that are held are from others, relatively."""
        held = [name for name in self.at if name not in self.free]
        return sum(abs(self.at[name] - values[name]) / (abs(values[name]) + 1e-9) for name in held)

    def use(self) -> EffectUse:
        """The effect at the values about which it is linear."""
        return EffectUse(self.effect.name, dict(self.at), self.rotor)


def make_candidates(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    segments: Sequence[Segment],
    thresholds: PredictionThresholds = DEFAULT.prediction,
) -> tuple[Candidate, ...]:
    """All effects that these flights could show, at each point of their grids, in the order of the catalogue."""
    span, min_lag = _span(segments), thresholds.min_lag_rows / min(s.rate for s in segments)
    candidates: list[Candidate] = []
    for effect in catalogue.values():
        if effect.stochastic or not can_show(effect, segments, vehicle, catalogue):
            continue
        for rotor in range(vehicle.rotors.count) if effect.per_rotor else (None,):
            own = next((u for u in vehicle.effects if (u.name, u.rotor) == (effect.name, rotor)), None)
            present = None if own is None else {**effect.defaults(vehicle), **own.parameters}
            for at, free in _grid(effect, present, _resolved(effect, vehicle, span, min_lag)):
                candidates.append(Candidate(effect, rotor, at, free, present))
    return tuple(candidates)


def _resolved(effect: Effect, vehicle: Vehicle, span: Span, min_lag: float) -> list[Mapping[str, float]]:
    """Points of an effect's grid but those with a time constant, s, shorter than the logs' rate resolves.

    Where none is left, those with the longest: what is faster acts like it, only less.
    """
    points = list(effect.grid(vehicle, span)) if effect.grid is not None else [{}]

    def shortest(point: Mapping[str, float]) -> float:
        return min((point[name] for name in effect.time_constants if name in point), default=np.inf)

    limit = min(min_lag, max(map(shortest, points), default=np.inf))
    return [point for point in points if shortest(point) >= limit]


def _grid(
    effect: Effect, present: Mapping[str, float] | None, points: Sequence[Mapping[str, float]]
) -> list[tuple[dict[str, float], tuple[str, ...]]]:
    """(values about which it is linear, free parameters) at each point of an effect's grid.

    An effect that the vehicle's model holds has one point, its present values, where it is linear in some parameters:
    what is regressed is their error. Where it is linear in none, what other values change is regressed.
    """
    names = tuple(p.name for p in effect.parameters)
    if present is None:
        neutral = {p.name: p.neutral for p in effect.parameters}
        return [({**neutral, **held}, tuple(name for name in names if name not in held)) for held in points]
    free = tuple(name for name in names if name not in points[0])
    if free:
        return [(dict(present), free)]
    others = [held for held in points if max(abs(held[n] - present[n]) for n in names) >= effect.min_detectable]
    return [({**present, **held}, ()) for held in others if any(held[n] != present[n] for n in names)]


def without(vehicle: Vehicle, candidate: Candidate) -> tuple[EffectUse, ...]:
    """The vehicle file's effects except this one."""
    return tuple(u for u in vehicle.effects if (u.name, u.rotor) != (candidate.effect.name, candidate.rotor))


def _span(segments: Sequence[Segment]) -> Span:
    everything = np.vstack([s.position for s in segments])
    lowest, highest = everything.min(axis=0).tolist(), everything.max(axis=0).tolist()
    return Span((lowest[0], lowest[1], lowest[2]), (highest[0], highest[1], highest[2]))
