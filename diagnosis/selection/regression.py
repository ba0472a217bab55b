"""The regression: one whitened Gram matrix a flight, from which everything else is small linear algebra.

Every flight has its own clock offset, gyro's bias and accelerometer's bias, with the sensors' specification as their
prior: millisecond offsets are otherwise the most frequent false alarm. They are marginalised at once, so that a fault
of a sensor is what all flights share beyond them. So is a gust of a given strength (`Regression.in_gust`).

Where only commands were logged, the gain and the curve from command to thrust are unknowns that all flights share. They
are marginalised in every solution, so that drag, mass and inertia compete with them on equal terms.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.models.command_effects import COMMAND_EFFECTS, GAIN, prior_deviation, with_command_effects
from diagnosis.models.pose_errors import NO_ERRORS, PoseErrors, pose_errors
from diagnosis.selection.air_motion import Waves, Whitened, make_waves
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.design_matrix import DesignMatrix, evaluate_design
from diagnosis.selection.errors_in_variables import design_errors
from diagnosis.selection.noise import NoiseModel, estimate_noise
from diagnosis.selection.sensor_errors import NO_BIASES, Biases, SensorErrors, sensor_biases
from diagnosis.thresholds import DEFAULT, CommandCurveThresholds, GustThresholds, Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class FlightEquations:
    """One flight's normal equations in still air, its biases among the columns, and its waves of random air motion.

    gram, product: (k, k) and (k,) with errors-in-variables correction.
    plain_gram, plain_product: without.
    waves: None where no wind is regressed.
    """

    gram: Floats
    product: Floats
    plain_gram: Floats
    plain_product: Floats
    waves: Waves | None = None

    def beside_gust(self, variance: float, places: Sequence[int], *, corrected: bool = True) -> tuple[Floats, Floats]:
        """(p, p) and (p,) normal equations of the columns at some places beside a gust of this variance, (m/s)^2."""
        gram, product = (self.gram, self.product) if corrected else (self.plain_gram, self.plain_product)
        gram, product = gram[np.ix_(places, places)], product[places]
        if self.waves is None or variance == 0:
            return gram, product
        less, less_product = self.waves.reduction(variance, places, corrected=corrected)
        return gram - less, product - less_product


@dataclass(eq=False)
class Regression:
    """Normal equations of all candidates, a set for each flight.

    segments, flight_of: what was fitted, and the flight of each segment.
    candidates: all of them; the model that they are added to is the vehicle's.
    nuisances: corrections of the vehicle's command gain and curve, in every fit and never named; none where rotor
        speeds were measured.
    noise: by which residuals are whitened.
    rows: (m, 12) residuals of the vehicle's model, a segment each.
    columns: (m, 12, k) for detection, a segment each.
    gram, product: (k, k) and (k,) a flight, with errors-in-variables correction, biases marginalised.
    plain_gram, plain_product: biases marginalised, without that correction.
    joint_gram, joint_product: with that correction, biases not marginalised.
    biases: each flight's own.
    shared: the nuisances' priors; `gram` and `product` hold their columns like any others.
    observations: number of whitened residuals of each flight.
    rate: of the rows, Hz.
    design: makes rows and columns of other segments.
    everything: (k,) ridge coefficients of all columns at once.
    equations: of each flight in still air.
    pose: errors of the segments' pose that are noise.
    errors: of rows (m, 12) and columns (m, 12, k) that noise added to a segment causes, a segment each.
    thresholds: for all that is built on this regression.
    gust_variance: of the gust that is marginalised in all normal equations, (m/s)^2.
    not_followed: effects whose hidden states the logs' rate is too low for, which are no candidates.
    """

    vehicle: Vehicle
    catalogue: Mapping[str, Effect]
    segments: Sequence[Segment]
    flight_of: Sequence[int]
    candidates: tuple[Candidate, ...]
    noise: NoiseModel
    rows: list[Floats]
    columns: list[Floats]
    gram: list[Floats]
    product: list[Floats]
    plain_gram: list[Floats]
    plain_product: list[Floats]
    joint_gram: list[Floats]
    joint_product: list[Floats]
    observations: list[int]
    rate: float
    biases: Biases
    design: DesignMatrix
    everything: Floats
    equations: Sequence[FlightEquations]
    pose: PoseErrors = NO_ERRORS
    errors: Sequence[tuple[Floats, NDArray[np.floating]]] = ()
    thresholds: Thresholds = DEFAULT
    gust_variance: float = 0.0
    not_followed: tuple[str, ...] = ()
    nuisances: tuple[Candidate, ...] = ()
    shared: Biases = NO_BIASES

    @cached_property
    def sensor_errors(self) -> SensorErrors:
        """Errors of the sensors within specification, for any segment."""
        return SensorErrors(self.vehicle, self.catalogue, self.segments, self.thresholds)

    @property
    def flights(self) -> range:
        """The flights by number."""
        return range(len(self.gram))

    @property
    def total(self) -> int:
        """Number of whitened residuals."""
        return sum(self.observations)

    @property
    def independent(self) -> float:
        """How many of them count as independent."""
        return self.thresholds.regression.independent_share * self.total

    def solve(
        self, chosen: Sequence[int], flights: Sequence[int] | None = None, *, plain: bool = False
    ) -> tuple[Floats, float]:
        """Coefficients of the chosen columns, and twice the log-likelihood that they gain.

        plain: without errors-in-variables correction.
        """
        where = list(chosen)
        if not where:
            return np.zeros(0), 0.0
        gram, product = self.summed(flights, plain=plain)
        theta, gain = solved(gram[np.ix_(where, where)], product[where])
        return theta, float(gain)

    def summed(self, flights: Sequence[int] | None = None, *, plain: bool = False) -> tuple[Floats, Floats]:
        """(k, k) and (k,) normal equations of all columns, summed over flights, with what these share marginalised.

        flights: by default all of them.
        """
        return marginal(*self._sums(range(len(self.product[0])), flights, plain=plain), self.shared)

    def nuisance_values(self, chosen: Sequence[int]) -> Floats:
        """Coefficients of what the flights share, beside the chosen columns."""
        places, where = list(self.shared.columns), list(chosen)
        theta, _ = self.solve(where)
        gram, product = self._sums([*places, *where])
        count = len(places)
        inner = gram[:count, :count] + np.diag(self.shared.information)
        return np.asarray(np.linalg.solve(inner, product[:count] + self.shared.pull - gram[:count, count:] @ theta))

    def _sums(
        self, places: Sequence[int], flights: Sequence[int] | None = None, *, plain: bool = False
    ) -> tuple[Floats, Floats]:
        """(p, p) and (p,) normal equations of the columns at some places, summed over flights."""
        flights = self.flights if flights is None else flights
        grams, products = (self.plain_gram, self.plain_product) if plain else (self.gram, self.product)
        gram: Floats = sum((grams[f][np.ix_(places, places)] for f in flights), np.zeros((len(places), len(places))))
        product: Floats = sum((products[f][places] for f in flights), np.zeros(len(places)))
        return gram, product

    def gain(self, chosen: Sequence[int], flights: Sequence[int] | None = None) -> float:
        """Twice the log-likelihood that the chosen columns gain beyond the biases."""
        return self.solve(chosen, flights)[1]

    def cross_validated_gain(self, chosen: Sequence[int]) -> float:
        """The same on each flight with coefficients from the others, without errors-in-variables correction.

        The gain and the curve of commands are estimated on the flight itself.
        """
        where = list(chosen)
        if not where:
            return 0.0
        flights = self.flights
        others = [self._plain(where, [f for f in flights if f != flight]) for flight in flights]
        theta, _ = solved(*map(np.array, _unzipped(others)))
        grams, products = map(np.array, _unzipped(self._plain(where, [flight]) for flight in flights))
        quadratic = np.einsum("fi,fij,fj->", theta, grams, theta)
        return float(2 * np.sum(theta * products) - quadratic)

    def _plain(self, where: Sequence[int], flights: Sequence[int]) -> tuple[Floats, Floats]:
        """The same sums for some columns, without errors-in-variables correction."""
        count, every = len(where), [*where, *self.shared.columns]
        shared = replace(self.shared, columns=tuple(range(count, len(every))))
        gram, product = marginal(*self._sums(every, flights, plain=True), shared)
        return gram[:count, :count], product[:count]

    @property
    def feels_air(self) -> bool:
        """Whether random air motion would show."""
        return all(one.waves is not None for one in self.equations)

    def in_gust(self, variance: float) -> Regression:
        """The same flights in a random air motion of this variance, (m/s)^2, which is marginalised."""
        if variance == self.gust_variance or not self.feels_air:
            return self
        everywhere = range(len(self.product[0]))
        (joint_gram, joint_product), plain = (
            _unzipped(one.beside_gust(variance, everywhere, corrected=corrected) for one in self.equations)
            for corrected in (True, False)
        )
        gram, product = _marginals(joint_gram, joint_product, self.biases)
        plain_gram, plain_product = _marginals(*plain, self.biases)
        return replace(
            self,
            gram=gram,
            product=product,
            plain_gram=plain_gram,
            plain_product=plain_product,
            joint_gram=joint_gram,
            joint_product=joint_product,
            gust_variance=variance,
        )

    def gust_profile(self, chosen: Sequence[int], variances: Sequence[float]) -> GustProfile:
        """The likelihood of gusts of these variances beside the chosen columns."""
        shared = replace(self.shared, columns=tuple(range(len(chosen), len(chosen) + len(self.shared.columns))))
        chosen, off = [*chosen, *self.shared.columns], list(self.biases.columns)
        own = [i for i in chosen if i not in off]
        alike = [own.index(i) if i in own else len(own) + off.index(i) for i in chosen]
        gains = np.zeros((len(variances), len(self.equations)))
        grams = np.zeros((*gains.shape, len(chosen), len(chosen)))
        products = np.zeros((*gains.shape, len(chosen)))
        biases = Biases(tuple(range(len(own), len(own) + len(off))), self.biases.information)
        for v, variance in enumerate(variances):
            for f, one in enumerate(self.equations):
                gram, product = one.beside_gust(variance, [*own, *off])
                free, free_product = marginal(gram, product, biases)
                grams[v, f], products[v, f] = free[np.ix_(alike, alike)], free_product[alike]
                gains[v, f] = explained_by_biases(gram, product, biases)
                gains[v, f] += 0.0 if one.waves is None else one.waves.gain(variance)
        return GustProfile(tuple(variances), gains, grams, products, shared)

    def residuals_after(self, chosen: Sequence[int]) -> list[Floats]:
        """(m, 12) residual of each segment without the chosen columns, its flight's biases and what flights share."""
        where = [*chosen, *(i for i in self.shared.columns if i not in chosen)]
        shared = dict(zip(self.shared.columns, self.nuisance_values(chosen).tolist(), strict=True))
        theta = np.concatenate([self.solve(chosen)[0], [shared[i] for i in where[len(chosen) :]]])
        off = []
        for gram, product in zip(self.joint_gram, self.joint_product, strict=True):
            places = list(self.biases.columns)
            inner = gram[np.ix_(places, places)] + np.diag(self.biases.information)
            off.append(np.linalg.solve(inner, product[places] - gram[np.ix_(places, where)] @ theta))
        return [
            y - x[:, :, where] @ theta - x[:, :, list(self.biases.columns)] @ off[flight]
            for y, x, flight in zip(self.rows, self.columns, self.flight_of, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class GustProfile:
    """The likelihood of gusts of some variances beside some columns, flight by flight, up to a constant.

    variances: (v,) (m/s)^2.
    gains: (v, f) twice the log-likelihood gained by the gust and the flight's biases.
    grams, products: (v, f, p, p) and (v, f, p) normal equations of the columns.
    shared: the last of these, which all flights share, with their prior.
    """

    variances: tuple[float, ...]
    gains: Floats
    grams: Floats
    products: Floats
    shared: Biases = NO_BIASES

    def total(self, weights: Floats | None = None) -> Floats:
        """(v,) twice the log-likelihood, columns included. weights: (f,) how often each flight counts."""
        counts = np.ones(self.gains.shape[1]) if weights is None else weights
        total = self.gains @ counts
        if self.products.shape[2]:
            prior, pull = np.zeros(self.products.shape[2]), np.zeros(self.products.shape[2])
            prior[list(self.shared.columns)], pull[list(self.shared.columns)] = (
                self.shared.information,
                self.shared.pull,
            )
            gram = np.einsum("vfij,f->vij", self.grams, counts) + np.diag(prior)
            total = total + solved(gram, counts @ self.products + pull)[1]
        return np.asarray(total)


def solved(gram: Floats, product: Floats) -> tuple[Floats, Floats]:
    """Solutions (..., p) of normal equations (..., p, p) and (..., p), and their gains (...)."""
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 1e-9))
    matrix = gram / (scale[..., :, None] * scale[..., None, :]) + 1e-8 * np.eye(gram.shape[-1])
    theta = np.linalg.solve(matrix, (product / scale)[..., None])[..., 0] / scale
    return theta, np.sum(theta * product, axis=-1)


def make_regression(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    segments: Sequence[Segment],
    flight_of: Sequence[int],
    thresholds: Thresholds = DEFAULT,
) -> Regression:
    """The regression of all candidates over segments of flights numbered from 0."""
    vehicle, catalogue = with_command_effects(vehicle, catalogue, segments)
    evaluated = evaluate_design(vehicle, catalogue, segments, thresholds.prediction)
    design, rows, columns = evaluated.matrix, evaluated.rows, evaluated.columns
    candidates = tuple(c for c in evaluated.candidates if c.effect.name not in COMMAND_EFFECTS)
    nuisances = tuple(c for c in evaluated.candidates if c.effect.name in COMMAND_EFFECTS)
    noisier = design_errors(segments, design, rows, columns, thresholds.pose)
    errors = [(y, x.astype(np.float32)) for y, x in noisier]
    pose = pose_errors(segments, design.present, thresholds.pose)
    noise, everything = _noise(segments, rows, columns, pose, thresholds)
    equations = _equations(candidates, flight_of, noise, rows, columns, errors, segments[0].decimated_rate, thresholds)
    observations = [0] * len(equations)
    for flight, y in zip(flight_of, rows, strict=True):
        observations[flight] += (len(y) - noise.order) * len(noise.active)
    biases = flight_biases(candidates, nuisances, thresholds.command_curve)
    return Regression(
        vehicle=vehicle,
        catalogue=catalogue,
        segments=segments,
        flight_of=flight_of,
        candidates=candidates,
        noise=noise,
        rows=rows,
        columns=columns,
        **_still_air(equations, biases),
        observations=observations,
        rate=segments[0].decimated_rate,
        biases=biases,
        design=design,
        everything=everything,
        equations=equations,
        pose=pose,
        errors=errors,
        thresholds=thresholds,
        not_followed=evaluated.not_followed,
        nuisances=nuisances,
        shared=shared_unknowns(nuisances, thresholds.command_curve),
    )


def about_fit(
    regression: Regression, candidates: tuple[Candidate, ...], nuisances: tuple[Candidate, ...]
) -> Regression | None:
    """The regression about a fit of some candidates, which hold its values; None where that cannot be followed.

    Made again are the rows, and the columns of what the fit holds, of air and of what shares a model with them. Other
    columns change by as little as those effects change the vehicle, and so do the errors in variables.
    """
    r, thresholds = regression, regression.thresholds
    design = DesignMatrix(r.vehicle, r.catalogue, (*candidates, *nuisances), r.segments[0], thresholds.prediction)
    again = [design.again(segment, columns) for segment, columns in zip(r.segments, r.columns, strict=True)]
    rows, columns = _unzipped(again)
    if not all(np.isfinite(y).all() and np.isfinite(x).all() for y, x in again):
        return None
    pose = pose_errors(r.segments, design.present, thresholds.pose)
    noise, _ = _noise(r.segments, rows, columns, pose, thresholds)
    equations = _equations(candidates, r.flight_of, noise, rows, columns, r.errors, r.rate, thresholds)
    biases = flight_biases(candidates, nuisances, thresholds.command_curve)
    return replace(
        r,
        candidates=candidates,
        nuisances=nuisances,
        noise=noise,
        pose=pose,
        rows=rows,
        columns=columns,
        **_still_air(equations, biases),
        biases=biases,
        shared=shared_unknowns(nuisances, thresholds.command_curve),
        equations=equations,
        gust_variance=0.0,
    )


def _still_air(equations: Sequence[FlightEquations], biases: Biases) -> dict[str, Any]:
    """The fields of a regression with its normal equations, without a gust."""
    joint_gram, joint_product = [one.gram for one in equations], [one.product for one in equations]
    gram, product = _marginals(joint_gram, joint_product, biases)
    plain = [one.plain_gram for one in equations], [one.plain_product for one in equations]
    plain_gram, plain_product = _marginals(*plain, biases)
    return {
        "gram": gram,
        "product": product,
        "plain_gram": plain_gram,
        "plain_product": plain_product,
        "joint_gram": joint_gram,
        "joint_product": joint_product,
    }


def _equations(
    candidates: Sequence[Candidate],
    flight_of: Sequence[int],
    noise: NoiseModel,
    rows: Sequence[Floats],
    columns: Sequence[Floats],
    errors: Iterable[tuple[Floats, NDArray[np.floating]]],
    rate: float,
    thresholds: Thresholds,
) -> list[FlightEquations]:
    """The normal equations of each flight. errors: of rows (m, 12) and columns (m, 12, k), a segment each."""
    wind = next((list(c.columns) for c in candidates if c.effect.wind is not None), None)
    flights: list[list[tuple[Whitened, Floats]]] = [[] for _ in range(max(flight_of) + 1)]
    for flight, y, x, (y_error, x_error) in zip(flight_of, rows, columns, errors, strict=True):
        white_errors = noise.whiten(np.asarray(x_error, dtype=float)), noise.whiten(y_error)
        white = Whitened(noise.whiten(x), noise.whiten(y), *white_errors)
        flights[flight].append((white, x[:, :, wind or []]))
    return [
        flight_equations([one for one, _ in parts], [air for _, air in parts], noise, rate, thresholds.gust)
        for parts in flights
    ]


def flight_equations(
    segments: Sequence[Whitened], wind: Sequence[Floats], noise: NoiseModel, rate: float, thresholds: GustThresholds
) -> FlightEquations:
    """The normal equations of one flight. wind: (m, 12, a) regressors of a steady wind, a segment each."""
    width = segments[0].columns.shape[2]
    gram, correction = np.zeros((width, width)), np.zeros((width, width))
    product, product_correction = np.zeros(width), np.zeros(width)
    for segment in segments:
        x, y, x_error, y_error = segment.flat()
        gram += x.T @ x
        product += x.T @ y
        correction += x_error.T @ x_error
        product_correction += x_error.T @ y_error
    waves = make_waves(segments, wind, noise, rate, thresholds) if wind[0].shape[2] else None
    return FlightEquations(gram - correction, product - product_correction, gram, product, waves)


def _noise(
    segments: Sequence[Segment],
    rows: Sequence[Floats],
    columns: Sequence[Floats],
    pose: PoseErrors,
    thresholds: Thresholds,
) -> tuple[NoiseModel, Floats]:
    """The noise, from the residuals after all columns at once, and the coefficients (k,) of these."""
    kinds = np.all([channels.present(s) for s in segments], axis=0)
    active = [channel for channel in range(channels.CHANNELS) if kinds[channel // channels.AXES]]
    everything = _everything(rows, columns, active, thresholds.regression.ridge)
    residuals = [y - x @ everything for y, x in zip(rows, columns, strict=True)]
    # with commands alone the rotors' errors are in all channels, so correlation between channels is not sensor noise
    mixed, rate = segments[0].rotor_source != "command", segments[0].decimated_rate
    return estimate_noise(residuals, rate, active, mixed=mixed, pose=pose, thresholds=thresholds.noise), everything


def _marginals(
    grams: Sequence[Floats], products: Sequence[Floats], biases: Biases
) -> tuple[list[Floats], list[Floats]]:
    return _unzipped(marginal(gram, product, biases) for gram, product in zip(grams, products, strict=True))


def _unzipped(pairs: Iterable[tuple[Floats, Floats]]) -> tuple[list[Floats], list[Floats]]:
    first, second = zip(*pairs, strict=True)
    return list(first), list(second)


def marginal(gram: Floats, product: Floats, biases: Biases) -> tuple[Floats, Floats]:
    """One flight's normal equations with its biases integrated out under their prior. gram: (k, k), product: (k,)."""
    places = list(biases.columns)
    inner = gram[np.ix_(places, places)] + np.diag(biases.information)
    solved = np.linalg.solve(inner, np.column_stack([gram[places], product[places] + biases.pull]))
    return gram - gram[:, places] @ solved[:, :-1], product - gram[:, places] @ solved[:, -1]


def explained_by_biases(gram: Floats, product: Floats, biases: Biases) -> float:
    """Twice the log-likelihood that one flight's biases gain, less what a gust takes off their certainty."""
    places = list(biases.columns)
    if not places:
        return 0.0
    inner = gram[np.ix_(places, places)] + np.diag(biases.information)
    return float(product[places] @ np.linalg.solve(inner, product[places]) - np.linalg.slogdet(inner)[1])


def _everything(rows: Sequence[Floats], columns: Sequence[Floats], active: Sequence[int], ridge: float) -> Floats:
    """(k,) coefficients of a ridge regression on all columns, whose residuals are mostly noise."""
    scale = np.sqrt(np.mean(np.vstack(rows) ** 2, axis=0)) + 1e-12
    some = list(active)
    x = np.vstack([(c[:, some] / scale[some, None]).reshape(-1, c.shape[2]) for c in columns])
    y = np.concatenate([(r[:, some] / scale[some]).ravel() for r in rows])
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-12
    x = x / size
    return np.asarray(np.linalg.solve(x.T @ x + ridge * len(y) * np.eye(x.shape[1]), x.T @ y) / size)


def flight_biases(
    candidates: Sequence[Candidate], nuisances: Sequence[Candidate], thresholds: CommandCurveThresholds
) -> Biases:
    """Each flight's own sensor errors and its own deviation from the gain of commands that all flights share."""
    sensors = sensor_biases(candidates)
    gains = [column for c in nuisances if c.effect is GAIN for column in c.columns]
    information = np.full(len(gains), thresholds.flight_gain_std**-2)
    return Biases((*sensors.columns, *gains), np.concatenate([sensors.information, information]))


def shared_unknowns(nuisances: Sequence[Candidate], thresholds: CommandCurveThresholds) -> Biases:
    """The gain, the motors' gains and the curve's bend, about their neutral values."""
    columns = [column for c in nuisances for column in c.columns]
    deviations = [prior_deviation(c.effect, thresholds) for c in nuisances]
    expected = [c.effect.parameters[0].neutral - c.at[c.effect.parameters[0].name] for c in nuisances]
    return Biases(tuple(columns), np.array(deviations) ** -2.0, np.array(expected))
