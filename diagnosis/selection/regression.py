"""The regression: one whitened Gram matrix a flight, from which everything else is small linear algebra.

Every flight has its own clock offset, gyro's bias and accelerometer's bias, with the sensors' specification as their
prior: millisecond offsets are otherwise the most frequent false alarm. They are marginalised at once, so that a fault
of a sensor is what all flights share beyond them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.selection.candidates import Candidate, make_candidates
from diagnosis.selection.design_matrix import DesignMatrix
from diagnosis.selection.errors_in_variables import normal_equation_biases
from diagnosis.selection.noise import NoiseModel, estimate_noise
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Biases:
    """Each flight's own sensor errors.

    columns: their places among the columns.
    information: their inverse prior variances.
    """

    columns: tuple[int, ...]
    information: Floats


@dataclass(eq=False)
class Regression:
    """Normal equations of all candidates, a set for each flight.

    segments, flight_of: what was fitted, and the flight of each segment.
    candidates: all of them; the model that they are added to is the vehicle's.
    noise: by which residuals are whitened.
    rows: (m, 12) residuals of the vehicle's model, a segment each.
    columns: (m, 12, k) for detection, a segment each.
    gram, product: (k, k) and (k,) a flight, with errors-in-variables correction, biases marginalised.
    plain_gram, plain_product: biases marginalised, without that correction.
    joint_gram, joint_product: with that correction, biases not marginalised.
    observations: number of whitened residuals of each flight.
    rate: of the rows, Hz.
    design: makes rows and columns of other segments.
    everything: (k,) ridge coefficients of all columns at once.
    thresholds: for all that is built on this regression.
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
    thresholds: Thresholds = DEFAULT

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
        flights = self.flights if flights is None else flights
        grams, products = (self.plain_gram, self.plain_product) if plain else (self.gram, self.product)
        gram: Floats = sum((grams[f][np.ix_(where, where)] for f in flights), np.zeros((len(where), len(where))))
        product: Floats = sum((products[f][where] for f in flights), np.zeros(len(where)))
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-9))
        matrix = gram / np.outer(scale, scale) + 1e-8 * np.eye(len(where))
        theta = np.linalg.solve(matrix, product / scale) / scale
        return theta, float(theta @ product)

    def gain(self, chosen: Sequence[int], flights: Sequence[int] | None = None) -> float:
        """Twice the log-likelihood that the chosen columns gain beyond the biases."""
        return self.solve(chosen, flights)[1]

    def cross_validated_gain(self, chosen: Sequence[int]) -> float:
        """The same on each flight with coefficients from the others, without errors-in-variables correction."""
        total, where = 0.0, list(chosen)
        for flight in self.flights:
            theta, _ = self.solve(where, [f for f in self.flights if f != flight])
            quadratic = theta @ self.plain_gram[flight][np.ix_(where, where)] @ theta
            total += float(2 * theta @ self.plain_product[flight][where] - quadratic)
        return total

    def residuals_after(self, chosen: Sequence[int]) -> list[Floats]:
        """(m, 12) residual of each segment without the chosen columns and its flight's biases."""
        where, theta = list(chosen), self.solve(chosen)[0]
        off = []
        for gram, product in zip(self.joint_gram, self.joint_product, strict=True):
            places = list(self.biases.columns)
            inner = gram[np.ix_(places, places)] + np.diag(self.biases.information)
            off.append(np.linalg.solve(inner, product[places] - gram[np.ix_(places, where)] @ theta))
        return [
            y - x[:, :, where] @ theta - x[:, :, list(self.biases.columns)] @ off[flight]
            for y, x, flight in zip(self.rows, self.columns, self.flight_of, strict=True)
        ]


def make_regression(
    vehicle: Vehicle,
    catalogue: Mapping[str, Effect],
    segments: Sequence[Segment],
    flight_of: Sequence[int],
    thresholds: Thresholds = DEFAULT,
) -> Regression:
    """The regression of all candidates over segments of flights numbered from 0."""
    candidates = make_candidates(vehicle, catalogue, segments)
    design = DesignMatrix(vehicle, catalogue, candidates, segments[0], thresholds.prediction)
    rows, columns = map(list, zip(*(design.evaluate(s) for s in segments), strict=True))
    noise, everything = _noise(segments, rows, columns, thresholds)
    plain = [noise.normal_equations(x, y) for x, y in zip(columns, rows, strict=True)]
    errors = normal_equation_biases(segments, design, noise, rows, columns)
    corrected = [(a - da, b - db) for (a, b), (da, db) in zip(plain, errors, strict=True)]
    plain_gram, plain_product = _by_flight(plain, flight_of)
    joint_gram, joint_product = _by_flight(corrected, flight_of)
    biases = sensor_biases(candidates)
    gram, product = _marginals(joint_gram, joint_product, biases)
    plain_gram, plain_product = _marginals(plain_gram, plain_product, biases)
    observations = [0] * len(gram)
    for flight, y in zip(flight_of, rows, strict=True):
        observations[flight] += (len(y) - noise.order) * len(noise.active)
    return Regression(
        vehicle=vehicle,
        catalogue=catalogue,
        segments=segments,
        flight_of=flight_of,
        candidates=candidates,
        noise=noise,
        rows=rows,
        columns=columns,
        gram=gram,
        product=product,
        plain_gram=plain_gram,
        plain_product=plain_product,
        joint_gram=joint_gram,
        joint_product=joint_product,
        observations=observations,
        rate=segments[0].decimated_rate,
        biases=biases,
        design=design,
        everything=everything,
        thresholds=thresholds,
    )


def _noise(
    segments: Sequence[Segment], rows: Sequence[Floats], columns: Sequence[Floats], thresholds: Thresholds
) -> tuple[NoiseModel, Floats]:
    """The noise, from the residuals after all columns at once, and the coefficients (k,) of these."""
    kinds = np.all([channels.present(s) for s in segments], axis=0)
    active = [channel for channel in range(channels.CHANNELS) if kinds[channel // channels.AXES]]
    everything = _everything(rows, columns, active, thresholds.regression.ridge)
    residuals = [y - x @ everything for y, x in zip(rows, columns, strict=True)]
    # with commands alone the rotors' errors are in all channels, so correlation between channels is not sensor noise
    mixed, rate = segments[0].rotor_source != "command", segments[0].decimated_rate
    return estimate_noise(residuals, rate, active, mixed=mixed, thresholds=thresholds.noise), everything


def _by_flight(
    equations: Sequence[tuple[Floats, Floats]], flight_of: Sequence[int]
) -> tuple[list[Floats], list[Floats]]:
    """Normal equations of segments, summed over each flight."""
    count, width = max(flight_of) + 1, len(equations[0][1])
    grams, products = [np.zeros((width, width)) for _ in range(count)], [np.zeros(width) for _ in range(count)]
    for (gram, product), flight in zip(equations, flight_of, strict=True):
        grams[flight] += gram
        products[flight] += product
    return grams, products


def _marginals(
    grams: Sequence[Floats], products: Sequence[Floats], biases: Biases
) -> tuple[list[Floats], list[Floats]]:
    free = [marginal(gram, product, biases) for gram, product in zip(grams, products, strict=True)]
    return [gram for gram, _ in free], [product for _, product in free]


def marginal(gram: Floats, product: Floats, biases: Biases) -> tuple[Floats, Floats]:
    """One flight's normal equations with its biases integrated out under their prior. gram: (k, k), product: (k,)."""
    places = list(biases.columns)
    inner = gram[np.ix_(places, places)] + np.diag(biases.information)
    solved = np.linalg.solve(inner, np.column_stack([gram[places], product[places]]))
    return gram - gram[:, places] @ solved[:, :-1], product - gram[:, places] @ solved[:, -1]


def _everything(rows: Sequence[Floats], columns: Sequence[Floats], active: Sequence[int], ridge: float) -> Floats:
    """(k,) coefficients of a ridge regression on all columns, whose residuals are mostly noise."""
    scale = np.sqrt(np.mean(np.vstack(rows) ** 2, axis=0)) + 1e-12
    some = list(active)
    x = np.vstack([(c[:, some] / scale[some, None]).reshape(-1, c.shape[2]) for c in columns])
    y = np.concatenate([(r[:, some] / scale[some]).ravel() for r in rows])
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-12
    x = x / size
    return np.asarray(np.linalg.solve(x.T @ x + ridge * len(y) * np.eye(x.shape[1]), x.T @ y) / size)


def sensor_biases(candidates: Sequence[Candidate]) -> Biases:
    """Columns of sensor errors within specification: of effects with a sensor prior, one candidate each."""
    columns: list[int] = []
    information: list[float] = []
    taken: set[str] = set()
    for candidate in candidates:
        deviation = candidate.effect.sensor_prior
        if deviation is None or candidate.key in taken:
            continue
        taken.add(candidate.key)
        if candidate.fixed_shape:  # its column is the effect of the size at which it was tried
            deviation /= next(iter(candidate.at.values()))
        columns += candidate.columns
        information += [deviation**-2] * len(candidate.columns)
    return Biases(tuple(columns), np.array(information))
