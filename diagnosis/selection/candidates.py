"""The effects that might be missing, as columns of a regression: linearised about the present model.

Columns come from the effects' own expressions. An effect that is linear in some of its parameters gives one column
for each of them and is tried at several values of the others; an effect whose parameters are all held gives one
column, the whole difference that it makes, whose amplitude must come out near 1.

Under feedback the controller answers turbulence within 30 ms, so rotor speeds carry the disturbance and the moments
of the rotors look like an error in inertia, or like lag. Columns for detection therefore take the rotors' moments
from slow measured motion; those for estimation and evaluation are the plain ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.filters import difference, slow
from diagnosis.data.segment import Segment
from diagnosis.models.prediction import Predictor
from diagnosis.selection.visibility import can_show
from dynamics.arrays import Floats
from dynamics.effect import Effect, Span
from dynamics.vehicle import EffectUse, Vehicle

ANGULAR = slice(6, 9)


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect with some parameters held. free: those that are regressed. at: values about which it is linear.

    columns: places of its columns in the regression. whole: it has one column, the difference that it makes in all.
    """

    effect: Effect
    rotor: int | None
    at: Mapping[str, float]
    free: tuple[str, ...]
    columns: tuple[int, ...]

    @property
    def whole(self) -> bool:
        """Whether all its parameters are held."""
        return not self.free

    @property
    def key(self) -> str:
        """Name in a model."""
        return self.effect.name if self.rotor is None else f"{self.effect.name}[{self.rotor}]"

    @property
    def values(self) -> dict[str, float]:
        """The same by the model's names."""
        return {f"{self.key}.{name}": value for name, value in self.at.items()}

    def use(self) -> EffectUse:
        """The effect at the values about which it is linear."""
        return EffectUse(self.effect.name, dict(self.at), self.rotor)


def make_candidates(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment]
) -> tuple[Candidate, ...]:
    """All variants of all effects that these flights could show, in the order of the catalogue."""
    span = _span(segments)
    found: list[Candidate] = []
    count = 0
    for effect in catalogue.values():
        if effect.stochastic or not can_show(effect, segments, vehicle, catalogue):
            continue
        for rotor in range(vehicle.rotors.count) if effect.per_rotor else (None,):
            for at, free in _variants(effect, rotor, vehicle, span):
                width = max(1, len(free))
                found.append(Candidate(effect, rotor, at, free, tuple(range(count, count + width))))
                count += width
    return tuple(found)


def _variants(
    effect: Effect, rotor: int | None, vehicle: Vehicle, span: Span
) -> list[tuple[dict[str, float], tuple[str, ...]]]:
    names = tuple(p.name for p in effect.parameters)
    neutral = {p.name: p.neutral for p in effect.parameters}
    known = next((u for u in vehicle.effects if u.name == effect.name and u.rotor == rotor), None)
    tried = effect.grid(vehicle, span) if effect.grid is not None else [{}]
    if known is not None:  # the model has it: regress how far off its values are
        at = {**effect.defaults(vehicle), **known.parameters}
        held = tried[0].keys()
        free = tuple(name for name in names if name not in held)
        return [(at, free)] if free else []
    return [({**neutral, **held}, tuple(name for name in names if name not in held)) for held in tried]


def without(vehicle: Vehicle, candidate: Candidate) -> tuple[EffectUse, ...]:
    """The vehicle file's effects but this one."""
    return tuple(u for u in vehicle.effects if (u.name, u.rotor) != (candidate.effect.name, candidate.rotor))


def make_predictor(
    vehicle: Vehicle, catalogue: Mapping[str, Effect], candidate: Candidate, segment: Segment
) -> Predictor:
    """The model with a candidate in it, with slopes in its free parameters; it serves all variants."""
    return Predictor(
        vehicle,
        [*without(vehicle, candidate), candidate.use()],
        catalogue,
        [f"{candidate.key}.{name}" for name in candidate.free],
        speed_measured=segment.rotor_source == "measured",
    )


@dataclass(frozen=True, eq=False)
class Instruments:
    """Rotor speeds that give the measured thrust and the moment that slow measured motion needs. (n, rotors)."""

    rotor_speed: Floats
    rotor_acceleration: Floats
    reduced_rate: float


def make_instruments(segment: Segment, vehicle: Vehicle) -> Instruments:
    """Instruments of a segment."""
    inertia = np.array(vehicle.body.inertia)
    rate = slow(segment.turning, segment.rate)
    moment = inertia * slow(difference(segment.turning, segment.rate), segment.rate)
    moment += np.cross(rate, inertia * rate)
    allocation = vehicle.rotors.allocation
    squares = segment.rotor_speed**2
    wanted = np.column_stack([squares @ allocation[0], moment])
    speed = np.sqrt(np.maximum(wanted @ np.linalg.pinv(allocation).T, 0.0))
    reduced = segment.rate / max(1, round(segment.rate / 25.0))
    return Instruments(speed, slow(segment.rotor_acceleration, segment.rate), reduced)


def _span(segments: Sequence[Segment]) -> Span:
    everything = np.vstack([s.position for s in segments])
    lowest, highest = everything.min(axis=0).tolist(), everything.max(axis=0).tolist()
    return Span((lowest[0], lowest[1], lowest[2]), (highest[0], highest[1], highest[2]))
