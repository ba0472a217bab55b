"""How large a hidden effect must be to show a given number of times above the noise floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis import channels
from diagnosis.dataset import Dataset
from diagnosis.evaluation import residuals
from diagnosis.regression import make_regression
from dynamics.effect import Parameter, Span
from dynamics.effects import CATALOGUE
from dynamics.vehicle import EffectUse, Vehicle

Floats = NDArray[np.float64]

SECANTS = 4
FARTHEST = 0.4  # of the way from neutral to a bound: a vehicle with three times its inertia is another vehicle
ONE_SIZE = ("heading", "distance", "scale", "correlation_time")  # parameters that say where or when, not how much


@dataclass(frozen=True, eq=False)
class Yardstick:
    """Flights of a vehicle that hides nothing, and their noise floor by kind of channel (4,)."""

    data: Dataset
    vehicle: Vehicle
    floor: Floats

    @classmethod
    def of(cls, data: Dataset, vehicle: Vehicle) -> Yardstick:
        """The yardstick that these flights are."""
        some = {name: CATALOGUE[name] for name in ("imu_bias", "gyro_bias", "time_delay")}
        floor = make_regression(vehicle, some, data.fitted, data.flight_of).noise.floor
        return cls(data, vehicle, _norms(floor[None]))

    def shown(self, use: EffectUse) -> float:
        """RMS that an effect makes, over the floor, at the kind of channel that shows it best."""
        stretches = self.data.fitted
        with_it = residuals(self.vehicle.with_effects(use), CATALOGUE, stretches)
        without = residuals(self.vehicle, CATALOGUE, stretches)
        made = _norms(np.vstack(with_it) - np.vstack(without))
        return float(np.max(made[self.floor > 0] / self.floor[self.floor > 0]))

    def sized(self, name: str, strength: float, random: np.random.Generator) -> EffectUse:
        """An effect in a random direction, on a random rotor, so large that it makes `strength` times the floor."""
        effect = CATALOGUE[name]
        held: dict[str, float] = {}
        if effect.variants is not None:
            tried = [v for v in effect.variants(self.vehicle, self._span()) if len(v) < len(effect.parameters)]
            held = dict(tried[int(random.integers(len(tried)))]) if tried else {}
        rotor = int(random.integers(self.vehicle.rotors.count)) if effect.per_rotor else None
        free = [p for p in effect.parameters if p.name not in held and p.name not in ONE_SIZE]
        towards = {p.name: _direction(p, self.vehicle, random) for p in free}

        def use(size: float) -> EffectUse:
            moved = {p.name: _bounded(p, size * towards[p.name]) for p in free}
            return EffectUse(name, {**held, **moved}, rotor)

        size = 1.0
        for _ in range(SECANTS):
            size *= strength / max(self.shown(use(size)), 1e-6)
        return use(size)

    def _span(self) -> Span:
        places = np.vstack([s.position for s in self.data.everything])
        lowest, highest = places.min(axis=0).tolist(), places.max(axis=0).tolist()
        return Span(tuple(lowest), tuple(highest))


def _bounded(parameter: Parameter, moved: float) -> float:
    """The value at a distance from neutral, but not near a bound."""
    low, high = (FARTHEST * (bound - parameter.neutral) for bound in (parameter.lower, parameter.upper))
    return float(parameter.neutral + np.clip(moved, low, high))


def _direction(parameter: Parameter, vehicle: Vehicle, random: np.random.Generator) -> float:
    """From neutral towards the usual value, more or less, or to either side where there is no side."""
    prior = parameter.prior(vehicle)
    usual = prior.mean - parameter.neutral
    return float(usual * random.uniform(0.6, 1.4) if usual else prior.std * random.normal())


def _norms(rows: Floats) -> Floats:
    """(4,) RMS norm over the three axes of each kind of channel. rows: (m, 12)."""
    squared = np.mean(np.asarray(rows) ** 2, axis=0).reshape(len(channels.KINDS), channels.AXES)
    return np.asarray(np.sqrt(squared.sum(axis=1)))
