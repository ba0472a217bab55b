"""The chosen effects fitted jointly with the full model, hidden states and sensors' faults included.

Gauss-Newton on the whitened residuals of the twelve channels. Where feedback ties a column to the disturbance the
slow columns serve as instruments; noise in the columns is compensated as in the regression.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from diagnosis import channels
from diagnosis.candidates import Candidate, make_instruments
from diagnosis.filters import Floats
from diagnosis.perturbation import perturbed
from diagnosis.prediction import Predictor
from diagnosis.regression import SEED, Biases, Regression, marginal
from diagnosis.stretch import Stretch
from dynamics.effect import Effect
from dynamics.vehicle import EffectUse, Vehicle

STEPS = 5
SETTLED = 0.02  # of its standard deviation by which a parameter still moves at the end
NUDGE = 0.02  # relative step of finite differences
REFINED = {"slung_load": ("length",), "wall_effect": ("scale",)}  # held while searching, fitted in the end


@dataclass(frozen=True)
class Estimate:
    """A parameter: value and standard deviation in `unit`."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True, eq=False)
class Fit:
    """vehicle: with the effects at their fitted values. estimates: by (effect's key, parameter)."""

    vehicle: Vehicle
    estimates: Mapping[tuple[str, str], Estimate]
    candidates: tuple[Candidate, ...]


def with_candidates(vehicle: Vehicle, candidates: Sequence[Candidate], values: Mapping[str, float]) -> Vehicle:
    """The vehicle with candidates in place of what it had of the same name, at values by the model's names."""
    keys = {(c.effect.name, c.rotor) for c in candidates}
    kept = [use for use in vehicle.effects if (use.name, use.rotor) not in keys]
    added = [
        EffectUse(c.effect.name, {n: values.get(f"{c.key}.{n}", at) for n, at in c.at.items()}, c.rotor)
        for c in candidates
    ]
    return msgspec.structs.replace(vehicle, effects=(*kept, *added))


def fit(regression: Regression, candidates: Sequence[Candidate]) -> Fit:
    """Joint fit of candidates on the regression's flights, starting from its linear solution."""
    if not candidates:
        return Fit(regression.vehicle, {}, ())
    problem = _Problem(regression, candidates)
    values, covariance = problem.start(), np.zeros((0, 0))
    for _ in range(STEPS):
        step, covariance = problem.step(values)
        values = problem.bounded(values, step)
        if np.all(np.abs(step) <= SETTLED * np.sqrt(np.maximum(np.diag(covariance), 0.0)) + 1e-15):
            break
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    estimates = {}
    for place, (candidate, name) in enumerate(problem.free):
        unit = next(p.unit for p in candidate.effect.parameters if p.name == name)
        estimates[candidate.key, name] = Estimate(float(values[place]), float(deviation[place]), unit)
    named = dict(zip(problem.names, values.tolist(), strict=True))
    vehicle = with_candidates(regression.vehicle, candidates, named)
    return Fit(vehicle, estimates, tuple(candidates))


class _Problem:
    def __init__(self, regression: Regression, candidates: Sequence[Candidate]) -> None:
        self._regression = regression
        self._candidates = candidates
        self.free = [(c, name) for c in candidates for name in _free(c)]
        self.names = [f"{c.key}.{name}" for c, name in self.free]
        self.bounds = [bounds(c.effect, name) for c, name in self.free]
        self.linear = [f"{c.key}.{n}" for c in candidates for n in c.free]
        self._predictor = Predictor(
            regression.vehicle,
            with_candidates(regression.vehicle, candidates, {}).effects,
            regression.catalogue,
            self.linear,
            speed_measured=regression.stretches[0].rotor_source == "measured",
        )
        self._instrumented = [c.effect.physics is not None for c, _ in self.free]
        random = np.random.default_rng(SEED)
        self._noisier = [perturbed(s, random) for s in regression.stretches]

    def start(self) -> Floats:
        """Values from the linear regression."""
        theta, _ = self._regression.solve([i for c in self._candidates for i in c.columns])
        found: dict[str, float] = {}
        place = 0
        for candidate in self._candidates:
            part = theta[place : place + len(candidate.columns)]
            place += len(part)
            if candidate.whole:
                found |= {f"{candidate.key}.{n}": float(part[0]) * v for n, v in candidate.at.items()}
            else:
                found |= {
                    f"{candidate.key}.{n}": candidate.at[n] + float(t)
                    for n, t in zip(candidate.free, part, strict=True)
                }
        return np.array([found.get(f"{c.key}.{n}", c.at[n]) for c, n in self.free])

    def bounded(self, values: Floats, step: Floats) -> Floats:
        """Values after a step, within their bounds."""
        low, high = np.array(self.bounds).T
        return np.asarray(np.clip(values + step, low, high))

    def step(self, values: Floats) -> tuple[Floats, Floats]:
        """Change of the parameters and their covariance, every flight's biases integrated out."""
        r, count, off = self._regression, len(self.free), list(self._regression.biases.columns)
        width = count + len(off)
        changed = dict(zip(self.names, values.tolist(), strict=True))
        grams = [np.zeros((width, width)) for _ in r.flights]
        products, own = [np.zeros(width) for _ in r.flights], np.zeros((count, count))
        pairs = zip(r.stretches, self._noisier, r.columns, r.flight_of, strict=True)
        for stretch, noisier, columns, flight in pairs:
            y, x, z = self._linear(stretch, changed)
            again_y, again_x, again_z = self._linear(noisier, changed)
            fixed = r.noise.whiten(columns[:, :, off])
            white_x = np.concatenate([r.noise.whiten(x), fixed], axis=2).reshape(-1, width)
            white_z = np.concatenate([r.noise.whiten(z), fixed], axis=2).reshape(-1, width)
            white_y = r.noise.whiten(y).ravel()
            error_z = r.noise.whiten(again_z - z).reshape(-1, count)
            error_x = r.noise.whiten(again_x - x).reshape(-1, count)
            error_y = r.noise.whiten(again_y - y).ravel()
            grams[flight] += white_z.T @ white_x
            grams[flight][:count, :count] -= error_z.T @ error_x
            products[flight] += white_z.T @ white_y
            products[flight][:count] -= error_z.T @ error_y
            own += white_z[:, :count].T @ white_z[:, :count]
        gram, product = np.zeros((count, count)), np.zeros(count)
        biases = Biases(tuple(range(count, width)), r.biases.information)
        for one, other in zip(grams, products, strict=True):
            one, other = marginal(one, other, biases)
            gram, product = gram + one[:count, :count], product + other[:count]
        scale = np.sqrt(np.maximum(np.abs(np.diag(gram)), 1e-300))
        inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-10) / np.outer(scale, scale)
        return inverse @ product, inverse @ own @ inverse.T

    def _linear(self, stretch: Stretch, changed: Mapping[str, float]) -> tuple[Floats, Floats, Floats]:
        """Residual (m, 12), slopes (m, 12, k) and instruments (m, 12, k) at values."""
        base = channels.predicted(stretch, [self._predictor.predict(stretch, changed)])[:, :, 0]
        slopes: dict[str, Floats] = {}
        instruments: dict[str, Floats] = {}
        if self.linear:
            plain = channels.predicted(stretch, self._predictor.slopes(stretch, changed))
            slopes = {name: plain[:, :, i] for i, name in enumerate(self.linear)}
            if any(self._instrumented):
                speed = make_instruments(stretch, self._regression.vehicle).rotor_speed
                found = channels.predicted(stretch, self._predictor.slopes(stretch, changed, rotor_speed=speed))
                instruments = {name: found[:, :, i] for i, name in enumerate(self.linear)}
        x, z = [], []
        for (_, _), name, instrumented in zip(self.free, self.names, self._instrumented, strict=True):
            slope = slopes[name] if name in slopes else self._difference(stretch, changed, name, base)
            x.append(slope)
            z.append(instruments[name] if instrumented and name in instruments else slope)
        return channels.measured(stretch) - base, np.stack(x, axis=2), np.stack(z, axis=2)

    def _difference(self, stretch: Stretch, changed: Mapping[str, float], name: str, base: Floats) -> Floats:
        step = NUDGE * max(abs(changed[name]), 1e-3)
        moved = self._predictor.predict(stretch, {**changed, name: changed[name] + step})
        return np.asarray((channels.predicted(stretch, [moved])[:, :, 0] - base) / step)


def _free(candidate: Candidate) -> tuple[str, ...]:
    if candidate.whole:
        return tuple(candidate.at)
    return (*candidate.free, *REFINED.get(candidate.effect.name, ()))


def bounds(effect: Effect, name: str) -> tuple[float, float]:
    """Physical bounds of an effect's parameter."""
    return next((p.lower, p.upper) for p in effect.parameters if p.name == name)
