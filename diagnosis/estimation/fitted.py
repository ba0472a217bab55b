"""Effects as a joint fit has them: values, intervals, and what remains without one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from diagnosis.selection.candidates import Candidate
from dynamics.arrays import Floats
from dynamics.vehicle import EffectUse, Vehicle


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter: value and standard deviation in `unit`."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True, eq=False)
class Fit:
    """Effects fitted jointly.

    vehicle: with the effects at their fitted values.
    estimates: by (effect's key, parameter).
    candidates: what was fitted.
    covariance: (k, k) of the estimates, in their order, those of the commands behind them.
    information: (k, k) normal equations of the same, biases marginalised.
    nuisances: what lies between command and thrust, fitted beside them; none where rotor speeds were measured.
    commands: estimates of these.
    """

    vehicle: Vehicle
    estimates: Mapping[tuple[str, str], ParameterEstimate]
    candidates: tuple[Candidate, ...]
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    information: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    nuisances: tuple[Candidate, ...] = ()
    commands: Mapping[tuple[str, str], ParameterEstimate] = field(default_factory=dict)

    @property
    def keys(self) -> tuple[str, ...]:
        """The candidates' names in a model."""
        return tuple(c.key for c in self.candidates)

    def of(self, candidate: Candidate) -> list[int]:
        """Places of a candidate's parameters among the estimates."""
        return [place for place, (key, _) in enumerate(self.estimates) if key == candidate.key]

    @property
    def values(self) -> dict[tuple[str, str], float]:
        """All fitted values by (key, parameter), those of the commands behind those of the effects."""
        return {key: estimate.value for key, estimate in (*self.estimates.items(), *self.commands.items())}


def with_candidates(vehicle: Vehicle, candidates: Sequence[Candidate], values: Mapping[str, float]) -> Vehicle:
    """The vehicle with candidates in place of what it had of the same name, at values by the model's names."""
    keys = {(c.effect.name, c.rotor) for c in candidates}
    others = [use for use in vehicle.effects if (use.name, use.rotor) not in keys]
    added = [
        EffectUse(c.effect.name, {n: values.get(f"{c.key}.{n}", at) for n, at in c.at.items()}, c.rotor)
        for c in candidates
    ]
    return msgspec.structs.replace(vehicle, effects=(*others, *added))


def neutral_values(fitted: Fit, candidate: Candidate, vehicle: Vehicle) -> dict[int, float]:
    """Values, by place among a fit's estimates, at which a candidate changes nothing.

    They are of the parameters in which the effect is linear, or of all where it has none: the vehicle's own values of
    an effect that it has, else neutral ones.
    """
    own = next((u.parameters for u in vehicle.effects if (u.name, u.rotor) == candidate.identity), None)
    neutral = {p.name: p.neutral for p in candidate.effect.parameters} if own is None else own
    linear = candidate.free or tuple(candidate.at)
    names = [name for _, name in fitted.estimates]
    return {i: neutral[names[i]] for i in fitted.of(candidate) if names[i] in linear and names[i] in neutral}


def left_out(
    fitted: Fit, candidate: Candidate, vehicle: Vehicle, *, held: Sequence[Candidate] = ()
) -> tuple[dict[tuple[str, str], float], Vehicle]:
    """A fit without one of its candidates: values of the other parameters, by the linearised equations, and vehicle.

    vehicle: that the candidates were added to. held: those of the others that keep their values.
    """
    keys, own = list(fitted.values), fitted.of(candidate)
    values = np.array(list(fitted.values.values()))
    change = np.zeros(len(own))
    for i, value in neutral_values(fitted, candidate, vehicle).items():
        change[own.index(i)] = value - values[i]
    constant = {one.key for one in held}
    rest = [i for i in range(len(keys)) if i not in own and keys[i][0] not in constant]
    others = [c for c in (*fitted.candidates, *fitted.nuisances) if c is not candidate]
    if rest:
        scale = np.sqrt(np.maximum(np.abs(np.diag(fitted.information)[rest]), 1e-300))
        inner = fitted.information[np.ix_(rest, rest)] / np.outer(scale, scale)
        across = fitted.information[np.ix_(rest, own)] / scale[:, None]
        values[rest] -= np.linalg.pinv(inner, rcond=1e-10) @ across @ change / scale
    limits = {(c.key, p.name): (p.lower, p.upper) for c in others for p in c.effect.parameters}
    moved = {keys[i]: float(np.clip(values[i], *limits[keys[i]])) for i in range(len(keys)) if i not in own}
    return moved, with_candidates(vehicle, others, {f"{key}.{name}": v for (key, name), v in moved.items()})
