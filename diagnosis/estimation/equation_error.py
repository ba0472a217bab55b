"""Equation error: the chosen effects fitted jointly with the full model, hidden states and sensors' faults included.

Gauss-Newton on the whitened residuals of the twelve channels. Where feedback correlates a column with the disturbance
the slow columns serve as instruments; errors in variables are corrected as in the regression.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from weakref import WeakKeyDictionary

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from diagnosis.data.filters import slow
from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.models.prediction import Predictor
from diagnosis.selection.candidates import Candidate, make_instruments, scales_rotors, without_lag
from diagnosis.selection.regression import Regression, marginal
from diagnosis.selection.sensor_errors import Biases
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.effects.time_delay import SENSOR_PRIOR as CLOCK_OFFSET
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
    unsettled: keys of effects on whose parameters the fit did not converge; their covariance says nothing.
    nuisances: what lies between command and thrust, fitted beside them; none where rotor speeds were measured.
    commands: estimates of these.
    chi_square: reduced, of the fitted flights.
    """

    vehicle: Vehicle
    estimates: Mapping[tuple[str, str], ParameterEstimate]
    candidates: tuple[Candidate, ...]
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    information: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    unsettled: frozenset[str] = frozenset()
    nuisances: tuple[Candidate, ...] = ()
    commands: Mapping[tuple[str, str], ParameterEstimate] = field(default_factory=dict)
    chi_square: float = float("nan")

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


def fit(
    regression: Regression,
    candidates: Sequence[Candidate],
    *,
    vehicle: Vehicle | None = None,
    start: Mapping[tuple[str, str], float] | None = None,
) -> Fit:
    """Joint fit of candidates on the regression's flights, and of gain and curve of commands where these are logged.

    vehicle: that they are added to; by default the regression's. start: values at which the fit begins, by (effect's
    key, parameter); by default the linear solution.
    """
    base = regression.vehicle if vehicle is None else vehicle
    if not (*candidates, *regression.nuisances):
        return Fit(base, {}, ())
    lacking = with_candidates(base, (*candidates, *regression.nuisances), {})
    fits = _fits.setdefault(regression, [])
    for of, at, before, fitted in fits:  # rivals, trials and the last report ask for the same fits
        if of == tuple(candidates) and at == start and before == lacking:
            return fitted
    fits.append((tuple(candidates), start, lacking, _fitted(regression, candidates, base, start)))
    return fits[-1][-1]


_fits: WeakKeyDictionary[
    Regression, list[tuple[tuple[Candidate, ...], Mapping[tuple[str, str], float] | None, Vehicle, Fit]]
] = WeakKeyDictionary()


def _fitted(
    regression: Regression,
    candidates: Sequence[Candidate],
    base: Vehicle,
    start: Mapping[tuple[str, str], float] | None,
) -> Fit:
    together = (*candidates, *regression.nuisances)
    problem = _EquationErrorProblem(regression, together, base)
    values, last, left = _settle(problem, problem.start(start))
    chi_square = last.cost / regression.total
    if problem.reweigh(values):
        values, last, left = _settle(problem, values)
        chi_square = problem.chi_square(values)
    covariance = last.covariance + np.outer(left, left)
    covariance += problem.clock_covariance(values, last)
    settled = last.is_small(left, regression.thresholds.equation_error.max_unsettled) & np.isfinite(last.cost)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    estimates: dict[tuple[str, str], ParameterEstimate] = {}
    commands: dict[tuple[str, str], ParameterEstimate] = {}
    for place, (candidate, name) in enumerate(problem.free):
        unit = next(p.unit for p in candidate.effect.parameters if p.name == name)
        group = commands if candidate in regression.nuisances else estimates
        group[candidate.key, name] = ParameterEstimate(float(values[place]), float(deviation[place]), unit)
    named = dict(zip(problem.names, values.tolist(), strict=True))
    unsettled = frozenset(c.key for (c, _), done in zip(problem.free, settled, strict=True) if not done)
    return Fit(
        with_candidates(base, together, named),
        estimates,
        tuple(candidates),
        covariance,
        last.information,
        unsettled,
        regression.nuisances,
        commands,
        chi_square,
    )


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


def left_out(fitted: Fit, candidate: Candidate, vehicle: Vehicle) -> tuple[dict[tuple[str, str], float], Vehicle]:
    """A fit without one of its candidates: values of the other parameters, by the linearised equations, and vehicle.

    vehicle: that the candidates were added to.
    """
    keys, own = list(fitted.values), fitted.of(candidate)
    values = np.array(list(fitted.values.values()))
    change = np.zeros(len(own))
    for i, value in neutral_values(fitted, candidate, vehicle).items():
        change[own.index(i)] = value - values[i]
    rest = [i for i in range(len(keys)) if i not in own]
    others = [c for c in (*fitted.candidates, *fitted.nuisances) if c is not candidate]
    if rest:
        scale = np.sqrt(np.maximum(np.abs(np.diag(fitted.information)[rest]), 1e-300))
        inner = fitted.information[np.ix_(rest, rest)] / np.outer(scale, scale)
        across = fitted.information[np.ix_(rest, own)] / scale[:, None]
        values[rest] -= np.linalg.pinv(inner, rcond=1e-10) @ across @ change / scale
    limits = {(c.key, p.name): (p.lower, p.upper) for c in others for p in c.effect.parameters}
    moved = {keys[i]: float(np.clip(values[i], *limits[keys[i]])) for i in rest}
    return moved, with_candidates(vehicle, others, {f"{key}.{name}": v for (key, name), v in moved.items()})


@dataclass(frozen=True, eq=False)
class _Step:
    """A Gauss-Newton step.

    change: (k,) of the parameters. covariance, information: (k, k) of them. cost: of the fit before the step.
    """

    change: Floats
    covariance: Floats
    information: Floats
    cost: float

    @property
    def deviations(self) -> float:
        """Length of the change, over the standard deviations."""
        return float(np.linalg.norm(self.change / np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))))

    def is_small(self, change: Floats, share: float) -> NDArray[np.bool_]:
        """(k,) whether a change is within a share of the standard deviations."""
        return np.asarray(np.abs(change) <= share * np.sqrt(np.maximum(np.diag(self.covariance), 0.0)) + 1e-15)


def _settle(problem: _EquationErrorProblem, start: Floats) -> tuple[Floats, _Step, Floats]:
    """Values to which Gauss-Newton converges, the step from there, and (k,) what of it the bounds allow.

    A step after which the fit is worse and the next step no smaller is halved: along a hidden state's parameters the
    fit is no parabola. The fit alone cannot judge, since instruments do not lead to its minimum.
    """
    thresholds, values = problem.thresholds, start
    here = problem.step(values)
    change = here.change
    for _ in range(thresholds.max_steps):
        moved = problem.bounded(values, change)
        if np.all(here.is_small(moved - values, thresholds.converged)):
            break
        there = problem.step(moved)
        grown = not there.cost <= thresholds.max_cost_growth * here.cost
        if grown and not (np.isfinite(there.cost) and there.deviations < here.deviations):
            change = change / 2
            continue
        values, here, change = moved, there, there.change
    return values, here, problem.bounded(values, here.change) - values


@dataclass(frozen=True, eq=False)
class _Rows:
    """A segment, whitened.

    flight: that it is of.
    y: (m, c) residuals.
    x, z: (m, c, k) slopes and instruments of the parameters, those of the biases behind them.
    starts: (b,) first rows of its blocks.
    error_gram, error_product: (b, k, k) and (b, k) what noise of the sensors' level adds to Z'X and Z'y of a block.
    """

    flight: int
    y: Floats
    x: Floats
    z: Floats
    starts: NDArray[np.intp]
    error_gram: Floats
    error_product: Floats

    def flat(self) -> tuple[Floats, Floats, Floats]:
        """The same with time and channels in one: (m c,), (m c, k), (m c, k)."""
        width = self.x.shape[2]
        return self.y.ravel(), self.x.reshape(-1, width), self.z.reshape(-1, width)


@dataclass(frozen=True, eq=False)
class _Equations:
    """Normal equations of parameters and biases behind them, a set for each flight.

    grams: Z'X. products: Z'y, both with errors-in-variables correction. instruments: Z'Z.
    rows: that they are summed over. cost: y'y.
    """

    grams: list[Floats]
    products: list[Floats]
    instruments: list[Floats]
    rows: list[_Rows]
    biases: Biases
    cost: float


class _EquationErrorProblem:
    """The least-squares problem of some candidates on a regression's flights."""

    def __init__(self, regression: Regression, candidates: Sequence[Candidate], vehicle: Vehicle) -> None:
        self._regression, self._vehicle = regression, vehicle
        self._noise = regression.noise
        self._candidates = candidates
        self.thresholds = regression.thresholds.equation_error
        self.free = [(c, name) for c in candidates for name in _free(c)]
        self.names = [f"{c.key}.{name}" for c, name in self.free]
        self.bounds = [bounds(c.effect, name) for c, name in self.free]
        self.linear = [f"{c.key}.{n}" for c in candidates for n in c.free]
        uses = with_candidates(vehicle, candidates, {}).effects
        self._predictor = self._model(uses, self.linear)
        self._lags = {f"{c.key}.{n}" for c, n in self.free if c.effect.rotor_speed is not None}
        self._information, self._expected = _priors(regression, self.free)
        self._own_slopes = _own_slopes(regression, self.names)
        self._instrumented = [scales_rotors(c) for c, _ in self.free]
        example = regression.segments[0]
        self._of_commands = example.rotor_source != "measured"
        self._cutoff = example.filters.command_cutoff if self._of_commands else example.filters.slow_cutoff
        self._instruments = self._predictor
        if self._predictor.model.rotor_speed_places:  # its rotors turn behind their commands, whatever speeds are given
            self._instruments = self._model(without_lag(uses, regression.catalogue), self.linear)
        self._errors: dict[int, tuple[Floats, Floats, Floats]] = {}
        self._block = max(regression.noise.order, round(self.thresholds.block * regression.rate))  # rows

    def _model(self, uses: Sequence[EffectUse], free: Sequence[str]) -> Predictor:
        r = self._regression
        measured = r.segments[0].rotor_source == "measured"
        return Predictor(
            self._vehicle, uses, r.catalogue, free, speed_measured=measured, thresholds=r.thresholds.prediction
        )

    def start(self, initial: Mapping[tuple[str, str], float] | None) -> Floats:
        """Values at which the fit begins: the initial ones, else those of the linear regression.

        Gain and curve of commands begin within three deviations of their prior: about another fit the linear solution
        may lie far beyond, from where the steps do not return.
        """
        starts = self._linear_solution() if initial is None else {f"{k}.{n}": v for (k, n), v in initial.items()}
        for place in [i for i, (c, _) in enumerate(self.free) if c in self._regression.nuisances]:
            mean, reach = self._expected[place], 3 / np.sqrt(self._information[place])
            name = self.names[place]
            starts[name] = float(np.clip(starts.get(name, mean), mean - reach, mean + reach))
        low, high = np.array(self.bounds).T
        return np.clip([starts.get(f"{c.key}.{n}", c.at[n]) for c, n in self.free], low, high)

    def _linear_solution(self) -> dict[str, float]:
        """Values by the model's names, from the linear regression."""
        shared = self._regression.shared.columns
        chosen = [i for c in self._candidates for i in c.columns if i not in shared]
        theta = np.concatenate([self._regression.solve(chosen)[0], self._regression.nuisance_values(chosen)])
        starts: dict[str, float] = {}
        place = 0
        for candidate in self._candidates:
            part = theta[place : place + len(candidate.columns)]
            place += len(part)
            if candidate.fixed_shape:
                scaled = candidate.scaled(float(part[0]))
                starts |= {f"{candidate.key}.{n}": value for n, value in scaled.items()}
            else:
                starts |= {
                    f"{candidate.key}.{n}": candidate.at[n] + float(t)
                    for n, t in zip(candidate.free, part, strict=True)
                }
        return starts

    def bounded(self, values: Floats, step: Floats) -> Floats:
        """Values after a step, within their bounds."""
        low, high = np.array(self.bounds).T
        return np.asarray(np.clip(values + step, low, high))

    def reweigh(self, values: Floats) -> bool:
        """Weigh each channel by what a fit leaves in it, where that is more than the noise; whether any weight changed.

        Where commands give the rotors' speeds, each channel has noise of its own. One that the model misses is no
        measure of what the others show.
        """
        if not self._of_commands or (equations := self._equations(self._named(values))) is None:
            return False
        squares = np.mean(np.concatenate([self._unbiased(equations, part) for part in equations.rows]) ** 2, axis=0)
        excess = np.where(squares > self.thresholds.min_excess, np.sqrt(squares), 1.0)
        self._noise = replace(self._noise, level=self._noise.level * excess)
        self._errors.clear()
        return bool(np.any(excess > 1.0))

    def _unbiased(self, equations: _Equations, part: _Rows) -> Floats:
        """(m, c) residuals of a segment less the biases of its flight."""
        places = list(equations.biases.columns)
        gram, product = equations.grams[part.flight], equations.products[part.flight]
        inner = gram[np.ix_(places, places)] + np.diag(equations.biases.information)
        return np.asarray(part.y - part.x[:, :, places] @ np.linalg.solve(inner, product[places]))

    def chi_square(self, values: Floats) -> float:
        """Reduced, at some values, by the regression's noise."""
        weighted, self._noise = self._noise, self._regression.noise
        result = self.step(values).cost / self._regression.total  # in which noise of the columns has no part
        self._noise = weighted
        return result

    def _named(self, values: Floats) -> dict[str, float]:
        return dict(zip(self.names, values.tolist(), strict=True))

    def clock_covariance(self, values: Floats, here: _Step) -> Floats:
        """(k, k) covariance that the commands' clock adds: a lag's own, or what one that is not fitted moves.

        here: the step from these values.
        """
        rate, model = self._regression.segments[0].rate, self._predictor.model
        result = np.diag([clock_variance(c.effect, name, rate) for c, name in self.free])
        fitted = {c.key for c in self._candidates}
        lags = [item for item in model.effects if item.effect.rotor_speed is not None and item.key not in fitted]
        for item in lags if np.isfinite(here.cost) else ():
            for name in item.effect.time_constants:
                key, deviation = f"{item.key}.{name}", np.sqrt(clock_variance(item.effect, name, rate))
                late = float(model.parameter_values[model.parameter_index(key)] + deviation)
                moved = self.step(values, {key: late})
                if np.isfinite(moved.cost):
                    result += np.outer(moved.change - here.change, moved.change - here.change)
        return np.asarray(result)

    def step(self, values: Floats, others: Mapping[str, float] | None = None) -> _Step:
        """The step from some values; every flight's biases are integrated out.

        The covariance is that of blocks of residuals (White, 1980), of few blocks also the noise model's.
        others: changed parameters that are not fitted, by name.
        """
        count = len(self.free)
        equations = self._equations({**self._named(values), **(others or {})})
        if equations is None:
            return _Step(np.zeros(count), np.zeros((count, count)), np.zeros((count, count)), np.inf)
        gram, product, noisy = np.zeros((count, count)), np.zeros(count), np.zeros((count, count))
        cost, biases = equations.cost, equations.biases
        for one, other, own in zip(equations.grams, equations.products, equations.instruments, strict=True):
            free, free_product = marginal(one, other, biases)
            gram, product = gram + free[:count, :count], product + free_product[:count]
            noisy += marginal(own, other, biases)[0][:count, :count]
            cost -= _explained_by_biases(one, other, biases)
        off = self._expected - values
        gram, product = gram + np.diag(self._information), product + self._information * off
        noisy += np.diag(self._information)
        cost += float(self._information @ off**2)
        scale = np.sqrt(np.maximum(np.abs(np.diag(gram)), 1e-300))
        inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-10) / np.outer(scale, scale)
        step = self._moved(gram, product)
        blocks, number = self._blocks(equations, step, inverse)
        blocks += np.diag(self._information)
        covariance = self._pooled(inverse @ noisy @ inverse.T, inverse @ blocks @ inverse.T, number)
        return _Step(step, covariance, gram, cost)

    def _moved(self, gram: Floats, product: Floats) -> Floats:
        """(k,) Gauss-Newton step of all parameters but those that are assumed."""
        moving = [i for i, (candidate, name) in enumerate(self.free) if name not in candidate.effect.assumed]
        some = np.ix_(moving, moving)
        scale = np.sqrt(np.maximum(np.abs(np.diag(gram)[moving]), 1e-300))
        step = np.zeros(len(self.free))
        step[moving] = (
            np.linalg.pinv(gram[some] / np.outer(scale, scale), rcond=1e-10) @ (product[moving] / scale) / scale
        )
        return step

    def _equations(self, changed: Mapping[str, float]) -> _Equations | None:
        """Normal equations of each flight at changed parameters, None where hidden states have diverged."""
        r, count = self._regression, len(self.free)
        width = count + len(r.biases.columns)
        grams, instruments = ([np.zeros((width, width)) for _ in r.flights] for _ in range(2))
        products, cost, rows = [np.zeros(width) for _ in r.flights], 0.0, []
        for part in self._rows(changed):
            y, x, z = part.flat()
            if not np.isfinite(y @ y) or not np.isfinite(x).all():
                return None
            grams[part.flight] += z.T @ x
            products[part.flight] += z.T @ y
            instruments[part.flight] += z.T @ z
            grams[part.flight][:count, :count] -= part.error_gram.sum(axis=0)
            products[part.flight][:count] -= part.error_product.sum(axis=0)
            cost += float(y @ y)
            rows.append(part)
        biases = Biases(tuple(range(count, width)), r.biases.information)
        return _Equations(grams, products, instruments, rows, biases, cost)

    def _rows(self, changed: Mapping[str, float]) -> Iterator[_Rows]:
        """Each segment's whitened rows."""
        r, off = self._regression, list(self._regression.biases.columns)
        for place, (segment, columns, flight) in enumerate(zip(r.segments, r.columns, r.flight_of, strict=True)):
            linear = self._linear(segment, changed)
            y, x, z = (self._noise.whiten(part) for part in linear)
            starts = np.arange(0, len(y), self._block)
            errors = self._errors_at(place, linear, changed, starts)
            fixed = self._noise.whiten(columns[:, :, off])
            white = [self._with_biases(part, fixed) for part in (x, z)]
            yield _Rows(flight, y, white[0], white[1], starts, *errors)

    def _errors_at(
        self, place: int, linear: Sequence[Floats], changed: Mapping[str, float], starts: NDArray[np.intp]
    ) -> tuple[Floats, Floats]:
        """What noise of the sensors' level adds to Z'X and Z'y of a segment's blocks: (b, k, k) and (b, k).

        They are computed once, since they change by as little as the columns do from step to step; of residuals at
        other values noise is less what it is of the columns.
        """
        values = np.array([changed[name] for name in self.names])
        if place not in self._errors:
            self._errors[place] = (values, *self._added_by_noise(place, linear, changed, starts))
        first, gram, product = self._errors[place]
        return gram, product - gram @ (values - first)

    def _added_by_noise(
        self, place: int, linear: Sequence[Floats], changed: Mapping[str, float], starts: NDArray[np.intp]
    ) -> tuple[Floats, Floats]:
        """(b, k, k) and (b, k) what noise of the sensors' level adds to Z'X and Z'y of each block of a segment.

        linear: y, x and z of the segment without it.
        """
        again = self._linear(self._regression.noisier[place], changed)
        y, x, z = (self._noise.whiten(b - a) for a, b in zip(linear, again, strict=True))
        products = np.einsum("mck,mc->mk", z, y)
        return _by_block(z, x, starts), np.asarray(np.add.reduceat(products, starts, axis=0))

    def _with_biases(self, slopes: Floats, biases: Floats) -> Floats:
        """Whitened slopes (m, c, k) and biases (m, c, b) beside each other.

        A flight's own gain of commands, or age of its pose, has the slope of the one that all share: at other values
        of the parameters the regression's column is not that slope, and the difference of the two would show the shared
        one as if no flight had its own.
        """
        together = np.concatenate([slopes, biases], axis=2)
        for bias, place, size in self._own_slopes:
            together[:, :, slopes.shape[2] + bias] = size * slopes[:, :, place]
        return together

    def _pooled(self, model: Floats, blocks: Floats, number: Floats) -> Floats:
        """The covariance (k, k) by the noise model, scaled to variances that blocks of residuals confirm.

        Where blocks vary more, the noise model is wrong, and theirs are the variances. Where they vary less, the model
        counts as `prior_blocks` of them. Intervals of 95 % are 1.96 deviations for normal errors, whose variance is
        known; that of few blocks is not, for which deviations grow by Student's quantile over that.
        number: (k,) of blocks that inform of each parameter.
        """
        prior = self.thresholds.prior_blocks
        ratio = np.diag(blocks) / np.maximum(np.diag(model), 1e-300)
        lower = (prior + number * ratio) / (prior + number)
        freedom = np.maximum(prior + number - 1, 2.0)
        wider = np.sqrt(np.maximum(ratio, lower)) * stdtrit(freedom, 0.975) / ndtri(0.975)
        return np.asarray(model * np.outer(wider, wider))

    def _blocks(self, equations: _Equations, step: Floats, inverse: Floats) -> tuple[Floats, Floats]:
        """(k, k) covariance of the parameters' scores, summed over blocks of time, and (k,) how many these amount to.

        Biases are taken off the residuals, and what their priors leave unknown is added again.

        A block that carries much of an effect draws the fit to itself and leaves residuals that are too small; scores
        are divided by the root of what it leaves, to first order (MacKinnon and White, 1985, HC2). What is taken off
        for errors in variables is part of them. inverse: (k, k) of the normal equations.
        """
        count, biases = len(step), equations.biases
        places = list(biases.columns)
        meat, shares, own_unknowns = np.zeros((count, count)), [], []
        for product, gram, instruments in zip(equations.products, equations.grams, equations.instruments, strict=True):
            inner = instruments[np.ix_(places, places)] + np.diag(biases.information)
            off = np.linalg.solve(inner, product[places] - gram[np.ix_(places, range(count))] @ step)
            mixed = np.linalg.solve(inner, instruments[np.ix_(places, range(count))])
            own_unknowns.append((off, mixed))
            meat += mixed.T @ (biases.information[:, None] * mixed)
        for part in equations.rows:
            off, mixed = own_unknowns[part.flight]
            residual = part.y - part.x[:, :, :count] @ step - part.x[:, :, places] @ off
            free = part.z[:, :, :count] - part.z[:, :, places] @ mixed
            scores = np.einsum("mck,mc->mk", free, residual)
            summed = np.add.reduceat(scores, part.starts, axis=0) - part.error_product + part.error_gram @ step
            own = _by_block(free, part.x[:, :, :count], part.starts) - part.error_gram
            apart = np.linalg.solve(np.eye(count) - own @ inverse / 2, summed[:, :, None])[:, :, 0]
            meat += apart.T @ apart
            shares.append(np.einsum("jk,bkl,jl->bj", inverse, own, inverse))
        informed = np.maximum(np.concatenate(shares), 0.0)
        return meat, informed.sum(axis=0) ** 2 / np.maximum((informed**2).sum(axis=0), 1e-300)

    def _linear(self, segment: Segment, changed: Mapping[str, float]) -> tuple[Floats, Floats, Floats]:
        """Residual (m, 12), slopes (m, 12, k) and instruments (m, 12, k) at changed parameters."""
        base = channels.predicted(segment, [self._predictor.predict(segment, changed)])[:, :, 0]
        slopes: dict[str, Floats] = {}
        instruments: dict[str, Floats] = {}
        if self.linear:
            plain = channels.predicted(segment, self._predictor.slopes(segment, changed))
            slopes = {name: plain[:, :, i] for i, name in enumerate(self.linear)}
            scaling = [n for n, scales in zip(self.names, self._instrumented, strict=True) if scales and n in slopes]
            if scaling:
                logged = self._predictor.rotor_speed(segment, self._predictor.values(changed))
                vehicle = self._regression.vehicle
                speed = make_instruments(
                    segment, vehicle, logged, self._cutoff, slow_thrust=self._of_commands
                ).rotor_speed
                model = self._instruments.model
                at = {name: value for name, value in changed.items() if name in model.parameter_names}
                at_speed = self._instruments.slopes(segment, at, rotor_speed=speed, free=scaling)
                instruments = dict(zip(scaling, channels.predicted(segment, at_speed).transpose(2, 0, 1), strict=True))
        x, z = [], []
        for name, instrumented in zip(self.names, self._instrumented, strict=True):
            slope = slopes[name] if name in slopes else self._difference(segment, changed, name, base)
            x.append(slope)
            z.append(instruments[name] if instrumented and name in instruments else slope)
            if name in self._lags:
                z[-1] = slow(slope, segment.decimated_rate, segment.filters.slow_cutoff)
        return channels.measured(segment) - base, np.stack(x, axis=2), np.stack(z, axis=2)

    def _difference(self, segment: Segment, changed: Mapping[str, float], name: str, base: Floats) -> Floats:
        step = self.thresholds.difference_step * max(abs(changed[name]), 1e-3)
        moved = self._predictor.predict(segment, {**changed, name: changed[name] + step})
        return np.asarray((channels.predicted(segment, [moved])[:, :, 0] - base) / step)


def _free(candidate: Candidate) -> tuple[str, ...]:
    if candidate.fixed_shape:
        return tuple(candidate.at)
    return (*candidate.free, *candidate.effect.refine, *candidate.effect.assumed)


def _own_slopes(regression: Regression, names: Sequence[str]) -> list[tuple[int, int, float]]:
    """(bias, parameter, size) of each flight's unknowns of which all flights' is fitted: places among the biases and
    among the parameters' names, and what of the parameter the regression's column is of."""
    own: list[tuple[int, int, float]] = []
    for candidate in (*regression.candidates, *regression.nuisances):
        sized = [(name, 1.0) for name in candidate.free] or list(candidate.sizes.items())[:1]
        for column, (name, size) in zip(candidate.columns, sized, strict=True):
            key = f"{candidate.key}.{name}"
            if column in regression.biases.columns and key in names:
                own.append((regression.biases.columns.index(column), names.index(key), size))
    return own


def _priors(regression: Regression, free: Sequence[tuple[Candidate, str]]) -> tuple[Floats, Floats]:
    """Inverse prior variances and prior means of the free parameters.

    Of effects those have one in which they are not linear: of some flights hardly more is known of them.
    """
    shared = regression.shared
    places = {id(c): i for c in regression.nuisances for i in [shared.columns.index(c.columns[0])]}
    information, expected = np.zeros(len(free)), np.zeros(len(free))
    for i, (candidate, name) in enumerate(free):
        parameter = next(p for p in candidate.effect.parameters if p.name == name)
        if id(candidate) in places:
            information[i], expected[i] = shared.information[places[id(candidate)]], parameter.neutral
        elif name in (*candidate.effect.refine, *candidate.effect.assumed):
            prior = parameter.prior(regression.vehicle)
            information[i], expected[i] = prior.std**-2, prior.mean
    return information, expected


def clock_variance(effect: Effect, name: str, rate: float) -> float:
    """Variance, s^2, that a lag of the rotors behind their commands has by the commands' clock, 0 for other parameters.

    Commands are as old as clocks are apart, and are held for a time between none and a row: half of it is their mean
    age, of which the logs show nothing and the estimate takes none. rate: of the rows, Hz.
    """
    if effect.rotor_speed is None or name not in effect.time_constants:
        return 0.0
    return float(CLOCK_OFFSET**2 + (0.5 / rate) ** 2 / 3)


def bounds(effect: Effect, name: str) -> tuple[float, float]:
    """Physical bounds of an effect's parameter."""
    return next((p.lower, p.upper) for p in effect.parameters if p.name == name)


def _by_block(left: Floats, right: Floats, starts: NDArray[np.intp]) -> Floats:
    """(b, k, l) products of (m, c, k) and (m, c, l) over the rows of each block."""
    parts = zip(np.split(left, starts[1:]), np.split(right, starts[1:]), strict=True)
    return np.stack([x.reshape(-1, x.shape[2]).T @ y.reshape(-1, y.shape[2]) for x, y in parts])


def _explained_by_biases(gram: Floats, product: Floats, biases: Biases) -> float:
    places = list(biases.columns)
    inner = gram[np.ix_(places, places)] + np.diag(biases.information)
    return float(product[places] @ np.linalg.solve(inner, product[places]))
