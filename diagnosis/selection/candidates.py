"""The effects that might be missing, as columns of a regression: linearised about the present model.

Columns come from the effects' own expressions. An effect that is linear in some of its parameters gives one column
for each of them and is tried on a grid of the others; an effect whose parameters are all held gives one column, a
fixed-shape regressor: the difference that it makes, whose coefficient must be near 1. An effect that the vehicle file
names already is a candidate for a correction: what is regressed is the difference that other values make.

Under feedback the controller responds to turbulence within 30 ms, so rotor speeds are correlated with the disturbance
and the moments of the rotors look like an error in inertia, or like lag. Columns for detection therefore take the
rotors' moments from slow measured motion; those for estimation and evaluation are the plain ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.data.filters import difference, slow
from diagnosis.data.segment import Segment
from diagnosis.models.command_effects import COMMAND_EFFECTS
from diagnosis.models.predictor import Predictor
from diagnosis.selection.visibility import can_show
from diagnosis.thresholds import DEFAULT, PredictionThresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect, Span
from dynamics.vehicle import EffectUse, Vehicle

Identity = tuple[str, int | None]  # an effect's name and its rotor


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at one point of its grid.

    effect: of the catalogue.
    rotor: that it acts on, if it is an effect of one rotor.
    at: values about which it is linear, of all parameters.
    free: parameters that are regressed.
    columns: places of its columns in the regression.
    present: values in the vehicle file, where it names the effect; without them the effect is absent.
    fitted: values about which it is linear instead, those of an earlier fit that holds it; the coefficients still
        count from `at`.
    """

    effect: Effect
    rotor: int | None
    at: Mapping[str, float]
    free: tuple[str, ...]
    columns: tuple[int, ...]
    present: Mapping[str, float] | None = None
    fitted: Mapping[str, float] | None = None

    @property
    def fixed_shape(self) -> bool:
        """Whether all its parameters are held, and its size is regressed."""
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
        return EffectUse(self.effect.name, {**self.at, **(self.fitted or {})}, self.rotor)

    def about(self, fitted: Mapping[str, float]) -> Candidate:
        """Candidate, linear about the values of a fit that holds it."""
        held = {name: fitted.get(name, value) for name, value in self.at.items() if name not in self.free}
        return replace(self, at={**self.at, **held}, fitted={**self.at, **fitted})

    @property
    def coefficients(self) -> list[float]:
        """Its coefficients in the model that is linearised: zeros, or those of the fit that holds it."""
        if self.fitted is None:
            return [0.0] * len(self.columns)
        return [self.fitted[name] - self.at[name] for name in self.free] or [1.0]


def make_candidates(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    segments: Sequence[Segment],
    thresholds: PredictionThresholds = DEFAULT.prediction,
) -> tuple[Candidate, ...]:
    """All effects that these flights could show, at each point of their grids, in the order of the catalogue."""
    span, min_lag = _span(segments), thresholds.min_lag_rows / min(s.rate for s in segments)
    candidates: list[Candidate] = []
    count = 0
    for effect in catalogue.values():
        if effect.stochastic or not can_show(effect, segments, vehicle, catalogue):
            continue
        for rotor in range(vehicle.rotors.count) if effect.per_rotor else (None,):
            own = next((u for u in vehicle.effects if (u.name, u.rotor) == (effect.name, rotor)), None)
            present = None if own is None else {**effect.defaults(vehicle), **own.parameters}
            for at, free in _grid(effect, present, _resolved(effect, vehicle, span, min_lag)):
                width = max(1, len(free))
                candidates.append(Candidate(effect, rotor, at, free, tuple(range(count, count + width)), present))
                count += width
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


def scales_rotors(candidate: Candidate) -> bool:
    """Whether a candidate's columns are the rotors' forces, which feedback correlates with the disturbance."""
    effect = candidate.effect
    return effect.physics is not None or effect.acts_on == "command_gain" or effect.name in COMMAND_EFFECTS


def shifts_rotors(candidate: Candidate) -> bool:
    """Whether a candidate's columns are the rotors' forces earlier or later, with which feedback correlates, too."""
    return candidate.effect.rotor_speed is not None or candidate.effect.acts_on == "rotor_clock"


def without(vehicle: Vehicle, candidate: Candidate) -> tuple[EffectUse, ...]:
    """The vehicle file's effects except this one."""
    return tuple(u for u in vehicle.effects if (u.name, u.rotor) != (candidate.effect.name, candidate.rotor))


def without_lag(uses: Sequence[EffectUse], catalogue: Mapping[str, Effect]) -> list[EffectUse]:
    """Effects but a lag of the rotors, so that the rotors turn at the speeds that are given."""
    return [use for use in uses if catalogue[use.name].rotor_speed is None]


def make_predictor(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    candidate: Candidate,
    segment: Segment,
    thresholds: PredictionThresholds = DEFAULT.prediction,
) -> Predictor:
    """The model with a candidate in it, with slopes in its free parameters, for all points of the effect's grid."""
    return Predictor(
        vehicle,
        [*without(vehicle, candidate), candidate.use()],
        catalogue,
        [f"{candidate.key}.{name}" for name in candidate.free],
        speed_measured=segment.rotor_source == "measured",
        thresholds=thresholds,
    )


@dataclass(frozen=True, eq=False)
class Instruments:
    """Rotor speeds with the thrust of the logged ones and the moment of slow measured motion.

    rotor_speed: (n, rotors) rad/s.
    logged: (n, rotors) those that give its thrust, rad/s.
    rotor_acceleration: (n, rotors) of the logged speeds, below the slow cutoff, rad/s^2.
    """

    rotor_speed: Floats
    logged: Floats
    rotor_acceleration: Floats


def make_instruments(
    segment: Segment,
    vehicle: Vehicle,
    rotor_speed: Floats | None = None,
    cutoff: float | None = None,
    *,
    slow_thrust: bool = False,
) -> Instruments:
    """Instruments of a segment.

    rotor_speed: (n, rotors) that give its thrust, by default the logged ones, rad/s.
    cutoff: below which motion is slow, by default that of detection, Hz.
    slow_thrust: whether the thrust, too, is that below the cutoff.
    """
    turned = segment.rotor_speed if rotor_speed is None else rotor_speed
    limit = segment.filters.slow_cutoff if cutoff is None else cutoff
    moment, rotor_acceleration = _slow_motion(segment, vehicle, limit)
    allocation = vehicle.rotors.allocation
    thrust = turned**2 @ allocation[0]
    if slow_thrust:
        thrust = slow(thrust, segment.rate, limit)
    wrench = np.column_stack([thrust, moment])
    speed = np.sqrt(np.maximum(wrench @ np.linalg.pinv(allocation).T, 0.0))
    return Instruments(speed, turned, rotor_acceleration)


def _slow_motion(segment: Segment, vehicle: Vehicle, cutoff: float) -> tuple[Floats, Floats]:
    """(n, 3) moment, N m, of a segment's motion below a cutoff, Hz, and (n, rotors) acceleration of its logged speeds,
    rad/s^2."""
    inertia = np.array(vehicle.body.inertia)
    turning = segment.rate_from_attitude if segment.has_attitude else segment.body_rate
    rate = slow(turning, segment.rate, cutoff)
    moment = inertia * slow(difference(turning, segment.rate), segment.rate, cutoff)
    moment += np.cross(rate, inertia * rate)
    return moment, slow(segment.rotor_acceleration, segment.rate, cutoff)


def _span(segments: Sequence[Segment]) -> Span:
    everything = np.vstack([s.position for s in segments])
    lowest, highest = everything.min(axis=0).tolist(), everything.max(axis=0).tolist()
    return Span((lowest[0], lowest[1], lowest[2]), (highest[0], highest[1], highest[2]))
