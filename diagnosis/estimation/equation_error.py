"""The chosen effects fitted jointly with the full model, hidden states and sensors' faults included.

Gauss-Newton on the whitened residuals of the twelve channels. Where feedback ties a column to the disturbance the
slow columns serve as instruments; noise in the columns is compensated as in the regression.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.models.prediction import Predictor
from diagnosis.selection.candidates import Candidate, make_instruments
from diagnosis.selection.errors_in_variables import perturbed
from diagnosis.selection.noise import ORDER
from diagnosis.selection.regression import SEED, Biases, Regression, marginal
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import EffectUse, Vehicle

STEPS = 8
WORSE = 1.001  # times the cost before, beyond which a step is halved
STABLE = 0.4  # rows, of the shortest lag that a Runge-Kutta step a row follows
BLOCK = 2.0  # s, over which residuals may hang together
SETTLED = 0.02  # of its standard deviation by which a parameter still moves at the end
NUDGE = 0.02  # relative step of finite differences


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
    values, covariance = _settle(problem)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    estimates = {}
    for place, (candidate, name) in enumerate(problem.free):
        unit = next(p.unit for p in candidate.effect.parameters if p.name == name)
        estimates[candidate.key, name] = Estimate(float(values[place]), float(deviation[place]), unit)
    named = dict(zip(problem.names, values.tolist(), strict=True))
    vehicle = with_candidates(regression.vehicle, candidates, named)
    return Fit(vehicle, estimates, tuple(candidates))


def _settle(problem: _Problem) -> tuple[Floats, Floats]:
    """Values to which Gauss-Newton comes from the linear solution, and their covariance.

    A step that makes the fit worse is halved: along a hidden state's parameters the fit is no parabola.
    """
    values = problem.start()
    step, covariance, cost = problem.step(values)
    for _ in range(STEPS):
        if np.all(np.abs(step) <= SETTLED * np.sqrt(np.maximum(np.diag(covariance), 0.0)) + 1e-15):
            break
        ahead = problem.bounded(values, step)
        next_step, next_covariance, next_cost = problem.step(ahead)
        if not next_cost <= WORSE * cost:
            step = step / 2
            continue
        values, step, covariance, cost = ahead, next_step, next_covariance, next_cost
    return values, covariance


@dataclass(frozen=True, eq=False)
class _Rows:
    """A segment's whitened residuals y (m, c), and slopes x and instruments z (m, c, k) with the biases behind them."""

    flight: int
    y: Floats
    x: Floats
    z: Floats

    def flat(self) -> tuple[Floats, Floats, Floats]:
        """The same with time and channels in one: (m c,), (m c, k), (m c, k)."""
        width = self.x.shape[2]
        return self.y.ravel(), self.x.reshape(-1, width), self.z.reshape(-1, width)


class _Problem:
    def __init__(self, regression: Regression, candidates: Sequence[Candidate]) -> None:
        self._regression = regression
        self._candidates = candidates
        self.free = [(c, name) for c in candidates for name in _free(c)]
        self.names = [f"{c.key}.{name}" for c, name in self.free]
        rate = regression.segments[0].rate
        self.bounds = [_stable(c.effect, name, rate) for c, name in self.free]
        self.linear = [f"{c.key}.{n}" for c in candidates for n in c.free]
        self._predictor = Predictor(
            regression.vehicle,
            with_candidates(regression.vehicle, candidates, {}).effects,
            regression.catalogue,
            self.linear,
            speed_measured=regression.segments[0].rotor_source == "measured",
        )
        self._instrumented = [c.effect.physics is not None for c, _ in self.free]
        random = np.random.default_rng(SEED)
        self._noisier = [perturbed(s, random) for s in regression.segments]

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
        low, high = np.array(self.bounds).T
        return np.clip([found.get(f"{c.key}.{n}", c.at[n]) for c, n in self.free], low, high)

    def bounded(self, values: Floats, step: Floats) -> Floats:
        """Values after a step, within their bounds."""
        low, high = np.array(self.bounds).T
        return np.asarray(np.clip(values + step, low, high))

    def step(self, values: Floats) -> tuple[Floats, Floats, float]:
        """Change of the parameters, their covariance, and the cost; every flight's biases are integrated out.

        The covariance is the greater of the noise model's and what blocks of residuals show (White, 1980, by blocks).
        """
        r, count = self._regression, len(self.free)
        width = count + len(r.biases.columns)
        grams, products = [np.zeros((width, width)) for _ in r.flights], [np.zeros(width) for _ in r.flights]
        own, total, rows = [np.zeros((width, width)) for _ in r.flights], 0.0, []
        for part, (error_y, error_x, error_z) in self._rows(dict(zip(self.names, values.tolist(), strict=True))):
            y, x, z = part.flat()
            if not np.isfinite(y @ y) or not np.isfinite(x).all():
                return np.zeros(count), np.zeros((count, count)), np.inf  # hidden states have run away
            grams[part.flight] += z.T @ x
            products[part.flight] += z.T @ y
            own[part.flight] += z.T @ z
            grams[part.flight][:count, :count] -= error_z.T @ error_x
            products[part.flight][:count] -= error_z.T @ error_y
            total += float(y @ y)
            rows.append(part)
        biases = Biases(tuple(range(count, width)), r.biases.information)
        gram, product, noisy = np.zeros((count, count)), np.zeros(count), np.zeros((count, count))
        for one, other, alone in zip(grams, products, own, strict=True):
            free, free_product = marginal(one, other, biases)
            gram, product = gram + free[:count, :count], product + free_product[:count]
            noisy += marginal(alone, other, biases)[0][:count, :count]
            total -= _explained_by_biases(one, other, biases)
        scale = np.sqrt(np.maximum(np.abs(np.diag(gram)), 1e-300))
        inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-10) / np.outer(scale, scale)
        step = inverse @ product
        shown = self._blocks(rows, grams, products, own, biases, step)
        covariance = _greater(inverse @ noisy @ inverse.T, inverse @ shown @ inverse.T)
        return step, covariance, total

    def _rows(self, changed: Mapping[str, float]) -> Iterator[tuple[_Rows, tuple[Floats, Floats, Floats]]]:
        """Each segment's whitened rows, and what the sensors' noise added once more changes in y, x and z."""
        r, off, count = self._regression, list(self._regression.biases.columns), len(self.free)
        for segment, noisier, columns, flight in zip(r.segments, self._noisier, r.columns, r.flight_of, strict=True):
            y, x, z = self._linear(segment, changed)
            again_y, again_x, again_z = self._linear(noisier, changed)
            fixed = r.noise.whiten(columns[:, :, off])
            white = [np.concatenate([r.noise.whiten(part), fixed], axis=2) for part in (x, z)]
            errors = [r.noise.whiten(part).reshape(-1, count) for part in (again_x - x, again_z - z)]
            yield (
                _Rows(flight, r.noise.whiten(y), white[0], white[1]),
                (r.noise.whiten(again_y - y).ravel(), errors[0], errors[1]),
            )

    def _blocks(
        self, rows: Sequence[_Rows], grams: Sequence[Floats], products: Sequence[Floats], own: Sequence[Floats],
        biases: Biases, step: Floats,
    ) -> Floats:  # fmt: skip
        """(k, k) sum over blocks of time of the squared scores of the parameters, biases taken out."""
        count, places = len(step), list(biases.columns)
        length = max(ORDER, round(BLOCK * self._regression.rate))
        meat = np.zeros((count, count))
        for part in rows:
            product, gram, instruments = products[part.flight], grams[part.flight], own[part.flight]
            inner = instruments[np.ix_(places, places)] + np.diag(biases.information)
            off = np.linalg.solve(inner, product[places] - gram[np.ix_(places, range(count))] @ step)
            mixed = np.linalg.solve(inner, instruments[np.ix_(places, range(count))])
            left = part.y - part.x[:, :, :count] @ step - part.x[:, :, places] @ off
            free = part.z[:, :, :count] - part.z[:, :, places] @ mixed
            scores = np.einsum("mck,mc->mk", free, left)
            starts = np.arange(0, len(scores), length)
            summed = np.add.reduceat(scores, starts, axis=0)
            meat += summed.T @ summed
        return meat

    def _linear(self, segment: Segment, changed: Mapping[str, float]) -> tuple[Floats, Floats, Floats]:
        """Residual (m, 12), slopes (m, 12, k) and instruments (m, 12, k) at values."""
        base = channels.predicted(segment, [self._predictor.predict(segment, changed)])[:, :, 0]
        slopes: dict[str, Floats] = {}
        instruments: dict[str, Floats] = {}
        if self.linear:
            plain = channels.predicted(segment, self._predictor.slopes(segment, changed))
            slopes = {name: plain[:, :, i] for i, name in enumerate(self.linear)}
            if any(self._instrumented):
                speed = make_instruments(segment, self._regression.vehicle).rotor_speed
                found = channels.predicted(segment, self._predictor.slopes(segment, changed, rotor_speed=speed))
                instruments = {name: found[:, :, i] for i, name in enumerate(self.linear)}
        x, z = [], []
        for (_, _), name, instrumented in zip(self.free, self.names, self._instrumented, strict=True):
            slope = slopes[name] if name in slopes else self._difference(segment, changed, name, base)
            x.append(slope)
            z.append(instruments[name] if instrumented and name in instruments else slope)
        return channels.measured(segment) - base, np.stack(x, axis=2), np.stack(z, axis=2)

    def _difference(self, segment: Segment, changed: Mapping[str, float], name: str, base: Floats) -> Floats:
        step = NUDGE * max(abs(changed[name]), 1e-3)
        moved = self._predictor.predict(segment, {**changed, name: changed[name] + step})
        return np.asarray((channels.predicted(segment, [moved])[:, :, 0] - base) / step)


def _free(candidate: Candidate) -> tuple[str, ...]:
    if candidate.whole:
        return tuple(candidate.at)
    return (*candidate.free, *candidate.effect.refine)


def _stable(effect: Effect, name: str, rate: float) -> tuple[float, float]:
    """Bounds within which rows at `rate` Hz can be integrated: a time constant is no shorter than 0.4 of a row."""
    low, high = bounds(effect, name)
    return (max(low, STABLE / rate) if name in effect.time_constants else low), high


def bounds(effect: Effect, name: str) -> tuple[float, float]:
    """Physical bounds of an effect's parameter."""
    return next((p.lower, p.upper) for p in effect.parameters if p.name == name)


def _explained_by_biases(gram: Floats, product: Floats, biases: Biases) -> float:
    places = list(biases.columns)
    inner = gram[np.ix_(places, places)] + np.diag(biases.information)
    return float(product[places] @ np.linalg.solve(inner, product[places]))


def _greater(one: Floats, other: Floats) -> Floats:
    """The first covariance, widened along each parameter to the other's standard deviation where that is greater."""
    variances = np.maximum(np.diag(one), 1e-300)
    wider = np.sqrt(np.maximum(np.diag(other) / variances, 1.0))
    return np.asarray(one * np.outer(wider, wider))
