"""Equation error: the chosen effects fitted jointly with the full model, hidden states and sensors' faults included.

Gauss-Newton on the whitened residuals of the twelve channels. Where feedback correlates a column with the disturbance
the slow columns serve as instruments; errors in variables are corrected as in the regression.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.workspace import key_of
from diagnosis.estimation.fit_equations import BlockRows, FitEquations, by_block, explained_by_biases, pooled
from diagnosis.estimation.fitted import Fit, ParameterEstimate, bounds, neutral_value, with_candidates
from diagnosis.estimation.gauss_newton import Step, settle, settle_from_afar
from diagnosis.estimation.linear_rows import LinearRows
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.noise import NoiseModel
from diagnosis.selection.regression import Regression, marginal
from diagnosis.selection.sensor_errors import Biases
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.effects.time_delay import SENSOR_PRIOR as CLOCK_OFFSET
from dynamics.vehicle import Vehicle


def fit(
    regression: Regression,
    candidates: Sequence[Candidate],
    *,
    vehicle: Vehicle | None = None,
    start: Mapping[tuple[str, str], float] | None = None,
    level: float = np.inf,
    goal: float = np.inf,
) -> Fit:
    """Joint fit of candidates on the regression's flights, and of gain and curve of commands where these are logged.

    vehicle: that they are added to; by default the regression's. start: values at which the fit begins, by (effect's
    key, parameter); by default the linear solution. level: reduced chi-square of a set that these are compared with; a
    fit that leaves far more is not made again where its way was not straight. goal: that it must reach to count; it is
    left, unsettled, where its steps do not lead there.
    """
    base = regression.vehicle if vehicle is None else vehicle
    if not (*candidates, *regression.nuisances):
        return Fit(base, {}, ())
    lacking = with_candidates(base, (*candidates, *regression.nuisances), {})
    hopeless = regression.thresholds.equation_error.hopeless * level
    limits = np.array([hopeless, goal])
    which = tuple((c.columns, *c.values.values()) for c in candidates)
    key = which, None if start is None else frozenset(start.items()), key_of(lacking)
    fits = regression.workspace.get("fits", key, list[tuple[Floats, Fit]])
    for limits_of_fit, fitted in fits:  # rivals, trials and the last report ask for the same fits
        if np.all((limits <= limits_of_fit) | (fitted.chi_square <= limits_of_fit)):
            return fitted
    fits.append((limits, _fitted(regression, candidates, base, start, hopeless=hopeless, goal=goal)))
    return fits[-1][1]


def _fitted(
    regression: Regression,
    candidates: Sequence[Candidate],
    base: Vehicle,
    start: Mapping[tuple[str, str], float] | None,
    *,
    hopeless: float = np.inf,
    goal: float = np.inf,
) -> Fit:
    together = (*candidates, *regression.nuisances)
    problem = _EquationErrorProblem(regression, together, base)
    total = regression.total
    ended = settle_from_afar(problem, problem.start(start), hopeless=hopeless * total, goal=goal * total)
    chi_square = ended.last.cost / total
    if not ended.is_short and problem.reweigh(ended.values):
        ended = settle(problem, ended.values)
        chi_square = problem.chi_square(ended.values)
    values, last, left = ended.values, ended.last, ended.left
    covariance = last.covariance + np.outer(left, left)
    covariance += problem.clock_covariance(values, last) + problem.pose_covariance(values, last)
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


class _EquationErrorProblem:
    """The least-squares problem of some candidates on a regression's flights."""

    def __init__(self, regression: Regression, candidates: Sequence[Candidate], vehicle: Vehicle) -> None:
        self._regression = regression
        self._noise = regression.noise
        self._candidates = candidates
        self.thresholds = regression.thresholds.equation_error
        self._linear = LinearRows(regression, candidates, vehicle)
        self.free, self.names = self._linear.free, self._linear.names
        self.bounds = [bounds(c.effect, name) for c, name in self.free]
        self._information, self._expected = _priors(regression, self.free)
        self._own_slopes = _own_slopes(regression, self.names)
        self._errors: dict[int, tuple[Floats, Floats, Floats]] = {}
        self._last: tuple[dict[str, float], list[tuple[Floats, Floats, Floats]]] = {}, []
        self._white_biases: tuple[NoiseModel, list[Floats]] = self._noise, []
        self._block = max(regression.noise.order, round(self.thresholds.block * regression.rate))  # rows

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

    def at_bounds(self, values: Floats) -> NDArray[np.bool_]:
        """(k,) whether a value is at a physical bound at which its effect does not vanish."""
        low, high = np.array(self.bounds).T
        neutral = np.array([neutral_value(c.effect, name) for c, name in self.free])
        return np.asarray(((values <= low) | (values >= high)) & (values != neutral))

    def reweigh(self, values: Floats) -> bool:
        """Weigh each channel by what a fit leaves in it, where that is more than the noise; whether any weight changed.

        Where commands give the rotors' speeds, each channel has noise of its own. One that the model misses is no
        measure of what the others show.
        """
        if not self._linear.of_commands or (equations := self._equations(self._named(values))) is None:
            return False
        squares = np.mean(np.concatenate([equations.unbiased(part) for part in equations.rows]) ** 2, axis=0)
        excess = np.where(squares > self.thresholds.min_excess, np.sqrt(squares), 1.0)
        self._noise = replace(self._noise, level=self._noise.level * excess)
        self._errors.clear()
        return bool(np.any(excess > 1.0))

    def chi_square(self, values: Floats) -> float:
        """Reduced, at some values, by the regression's noise."""
        weighted, self._noise = self._noise, self._regression.noise
        equations = self._equations(self._named(values))
        cost = np.inf if equations is None else self._cost(equations, values)  # in it noise of the columns has no part
        self._noise = weighted
        return cost / self._regression.total

    def _cost(self, equations: FitEquations, values: Floats) -> float:
        """Squared white residuals and distances from priors, each flight's biases at their best."""
        flights = zip(equations.grams, equations.products, strict=True)
        explained = sum(explained_by_biases(gram, product, equations.biases) for gram, product in flights)
        return equations.cost - explained + float(self._information @ (self._expected - values) ** 2)

    def _named(self, values: Floats) -> dict[str, float]:
        return dict(zip(self.names, values.tolist(), strict=True))

    def clock_covariance(self, values: Floats, here: Step) -> Floats:
        """(k, k) covariance that the commands' clock adds: a lag's own, or what one that is not fitted moves.

        here: the step from these values.
        """
        rate, model = self._regression.segments[0].rate, self._linear.predictor.model
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

    def pose_covariance(self, values: Floats, here: Step) -> Floats:
        """(k, k) covariance that an estimator's pose adds, whose errors are known in size and time by about a half.

        They are taken off the normal equations, and what that moves is as unsure. here: the step from these values.
        """
        limits, count = self._regression.thresholds.pose, len(self.free)
        if not self._regression.pose.there or not np.isfinite(here.cost):
            return np.zeros((count, count))
        moved = limits.unsure * (here.change - self.step(values, corrected=False).change)
        return np.asarray(np.outer(moved, moved))

    def step(self, values: Floats, others: Mapping[str, float] | None = None, *, corrected: bool = True) -> Step:
        """The step from some values; every flight's biases are integrated out.

        The covariance is that of blocks of residuals (White, 1980), of few blocks also the noise model's.
        others: changed parameters that are not fitted, by name. corrected: whether errors in variables are taken off.
        """
        count = len(self.free)
        equations = self._equations({**self._named(values), **(others or {})}, corrected=corrected)
        if equations is None:
            return Step(np.zeros(count), np.zeros((count, count)), np.zeros((count, count)), np.inf)
        gram, product, noisy = np.zeros((count, count)), np.zeros(count), np.zeros((count, count))
        biases = equations.biases
        for one, other, own in zip(equations.grams, equations.products, equations.instruments, strict=True):
            free, free_product = marginal(one, other, biases)
            gram, product = gram + free[:count, :count], product + free_product[:count]
            noisy += marginal(own, other, biases)[0][:count, :count]
        off = self._expected - values
        gram, product = gram + np.diag(self._information), product + self._information * off
        noisy += np.diag(self._information)
        scale = np.sqrt(np.maximum(np.abs(np.diag(gram)), 1e-300))
        inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-10) / np.outer(scale, scale)
        step = self._moved(gram, product)
        blocks, number = equations.scores(step, inverse)
        blocks += np.diag(self._information)
        covariance = pooled(
            inverse @ noisy @ inverse.T, inverse @ blocks @ inverse.T, number, self.thresholds.prior_blocks
        )
        return Step(step, covariance, gram, self._cost(equations, values))

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

    def _equations(self, changed: Mapping[str, float], *, corrected: bool = True) -> FitEquations | None:
        """Normal equations of each flight at changed parameters, None where hidden states have diverged.

        corrected: whether errors in variables are taken off them.
        """
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
            if corrected:
                grams[part.flight][:count, :count] -= part.error_gram.sum(axis=0)
                products[part.flight][:count] -= part.error_product.sum(axis=0)
            cost += float(y @ y)
            rows.append(part)
        biases = Biases(tuple(range(count, width)), r.biases.information)
        return FitEquations(grams, products, instruments, rows, biases, cost)

    def _rows(self, changed: Mapping[str, float]) -> Iterator[BlockRows]:
        """Each segment's whitened rows."""
        r, rows = self._regression, self._linear_rows(changed)
        for place, (linear, fixed, flight) in enumerate(zip(rows, self._biases(), r.flight_of, strict=True)):
            y, x, z = (self._noise.whiten(part) for part in linear)
            starts = np.arange(0, len(y), self._block)
            errors = self._errors_at(place, linear, changed, starts)
            white = [self._with_biases(part, fixed) for part in (x, z)]
            yield BlockRows(flight, y, white[0], white[1], starts, *errors)

    def _linear_rows(self, changed: Mapping[str, float]) -> list[tuple[Floats, Floats, Floats]]:
        """Residuals, slopes and instruments of each segment; of the last parameters they are kept, since other weights
        are tried, and the fit is judged, where it has ended."""
        if not self._last[1] or self._last[0] != changed:
            self._last = dict(changed), [self._linear.at(segment, changed) for segment in self._regression.segments]
        return self._last[1]

    def _biases(self) -> list[Floats]:
        """(m, c, b) whitened columns of the flights' biases, a segment each."""
        if not self._white_biases[1] or self._white_biases[0] is not self._noise:
            off = list(self._regression.biases.columns)
            white = [self._noise.whiten(columns[:, :, off]) for columns in self._regression.columns]
            self._white_biases = self._noise, white
        return self._white_biases[1]

    def _errors_at(
        self, place: int, linear: Sequence[Floats], changed: Mapping[str, float], starts: NDArray[np.intp]
    ) -> tuple[Floats, Floats]:
        """Errors-in-variables terms of Z'X and Z'y of a segment's blocks, by the sensors' level: (b, k, k) and (b, k).

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
        again = self._linear.at(self._regression.noisier[place], changed)
        y, x, z = (self._noise.whiten(b - a) for a, b in zip(linear, again, strict=True))
        products = np.einsum("mck,mc->mk", z, y)
        return by_block(z, x, starts), np.asarray(np.add.reduceat(products, starts, axis=0))

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
    places = {c.key: shared.columns.index(c.columns[0]) for c in regression.nuisances}
    information, expected = np.zeros(len(free)), np.zeros(len(free))
    for i, (candidate, name) in enumerate(free):
        parameter = next(p for p in candidate.effect.parameters if p.name == name)
        if candidate.key in places:
            information[i], expected[i] = shared.information[places[candidate.key]], parameter.neutral
        elif name in (*candidate.effect.refine, *candidate.effect.assumed):
            prior = parameter.prior(regression.vehicle)
            information[i], expected[i] = prior.std**-2, prior.mean
    return information, expected


def clock_variance(effect: Effect, name: str, rate: float) -> float:
    """Variance, s^2, that clocks add to a lag of the rotors behind their commands or to their age, 0 for others.

    Commands are as old as clocks are apart, and are held for a time between none and a row: half of it is their mean
    age, of which the logs show nothing and the estimate of a lag takes none. rate: of the rows, Hz.
    """
    if effect.acts_on == "rotor_clock":
        return float(CLOCK_OFFSET**2)
    if effect.rotor_speed is None or name not in effect.time_constants:
        return 0.0
    return float(CLOCK_OFFSET**2 + (0.5 / rate) ** 2 / 3)
