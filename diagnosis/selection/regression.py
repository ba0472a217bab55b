"""The regression: one whitened Gram matrix a flight, from which everything else is small linear algebra.

Every flight has its own clock offset, gyro's bias and accelerometer's bias, with what sensors are specified to have as
their prior: millisecond offsets are otherwise the most frequent false alarm. They are marginalised at once, so that a
fault of a sensor is what all flights share beyond them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.selection.candidates import Candidate, make_candidates
from diagnosis.selection.design_matrix import Pipeline
from diagnosis.selection.errors_in_variables import perturbed
from diagnosis.selection.noise import NoiseModel, estimate_noise
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle

RIDGE = 1e-6
SEED = 1


@dataclass(frozen=True, eq=False)
class Biases:
    """columns: places of what a flight's sensors are off by. information: inverse variances by specification."""

    columns: tuple[int, ...]
    information: Floats


@dataclass(eq=False)
class Regression:
    """Normal equations of all candidates, a set for each flight.

    gram: flights x (k, k), product: flights x (k,), both compensated for noise in the columns; plain_* are not. In
    all of them the flight's biases are marginalised; joint_gram and joint_product still hold them.
    rows: channels: what was measured less the model, (m, 12) a segment. columns: (m, 12, k) a segment, for detection.
    flight_of: the flight of each segment. observations: a flight's number of whitened residuals.
    pipeline: makes rows and columns of other segments. everything: (k,) coefficients of all columns at once, ridged.
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
    pipeline: Pipeline
    everything: Floats

    @property
    def flights(self) -> range:
        """The flights by number."""
        return range(len(self.gram))

    @property
    def total(self) -> int:
        """Number of whitened residuals."""
        return sum(self.observations)

    def solve(
        self, chosen: Sequence[int], flights: Sequence[int] | None = None, *, plain: bool = False
    ) -> tuple[Floats, float]:
        """Coefficients of the chosen columns, and twice the log-likelihood that they gain."""
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
        """Twice the log-likelihood that the chosen columns bring beyond the biases."""
        return self.solve(chosen, flights)[1]

    def crossed_gain(self, chosen: Sequence[int]) -> float:
        """The same on each flight with coefficients from the others, without compensation."""
        total, where = 0.0, list(chosen)
        for flight in self.flights:
            theta, _ = self.solve(where, [f for f in self.flights if f != flight])
            quadratic = theta @ self.plain_gram[flight][np.ix_(where, where)] @ theta
            total += float(2 * theta @ self.plain_product[flight][where] - quadratic)
        return total

    def left_over(self, chosen: Sequence[int]) -> list[Floats]:
        """(m, 12) residual of each segment with the chosen columns and its flight's biases taken out."""
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
    vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment], flight_of: Sequence[int]
) -> Regression:
    """The regression of all candidates over segments of flights numbered from 0."""
    candidates = make_candidates(vehicle, catalogue, segments)
    pipeline = Pipeline(vehicle, catalogue, candidates, segments[0])
    rows, columns = map(list, zip(*(pipeline.run(s) for s in segments), strict=True))
    kinds = np.all([channels.present(s) for s in segments], axis=0)
    active = [3 * kind + axis for kind in range(4) for axis in range(3) if kinds[kind]]
    rate = segments[0].rate / max(1, round(segments[0].rate / 25.0))
    # with commands alone the rotors' own errors are in all channels, and what these have in common is no sensor's
    mixed = segments[0].rotor_source != "command"
    everything = _everything(rows, columns, active)
    left = [y - x @ everything for y, x in zip(rows, columns, strict=True)]
    noise = estimate_noise(left, rate, active, mixed=mixed)
    count = max(flight_of) + 1
    width = columns[0].shape[2]
    grams = [np.zeros((width, width)) for _ in range(count)]
    products = [np.zeros(width) for _ in range(count)]
    plain_grams, plain_products = [g.copy() for g in grams], [b.copy() for b in products]
    observations = [0] * count
    random = np.random.default_rng(SEED)
    for segment, flight, y, x in zip(segments, flight_of, rows, columns, strict=True):
        white_y, white_x = noise.whiten(y), noise.whiten(x)
        again_y, again_x = pipeline.run(perturbed(segment, random))
        error_y, error_x = noise.whiten(again_y - y), noise.whiten(again_x - x)
        gram, product = _normal(white_x, white_y)
        error_gram, error_product = _normal(error_x, error_y)
        plain_grams[flight] += gram
        plain_products[flight] += product
        grams[flight] += gram - error_gram
        products[flight] += product - error_product
        observations[flight] += white_y.size
    biases = _biases(candidates)
    free = [marginal(g, b, biases) for g, b in zip(grams, products, strict=True)]
    plain = [marginal(g, b, biases) for g, b in zip(plain_grams, plain_products, strict=True)]
    return Regression(
        vehicle, catalogue, segments, flight_of, candidates, noise, rows, columns,
        [g for g, _ in free], [b for _, b in free], [g for g, _ in plain], [b for _, b in plain],
        grams, products, observations, rate, biases, pipeline, everything,
    )  # fmt: skip


def marginal(gram: Floats, product: Floats, biases: Biases) -> tuple[Floats, Floats]:
    """One flight's normal equations with its biases integrated out under their prior. gram: (k, k), product: (k,)."""
    places = list(biases.columns)
    inner = gram[np.ix_(places, places)] + np.diag(biases.information)
    solved = np.linalg.solve(inner, np.column_stack([gram[places], product[places]]))
    return gram - gram[:, places] @ solved[:, :-1], product - gram[:, places] @ solved[:, -1]


def _everything(rows: Sequence[Floats], columns: Sequence[Floats], active: Sequence[int]) -> Floats:
    """(k,) coefficients of a ridge regression on all columns, which leaves mostly noise."""
    scale = np.sqrt(np.mean(np.vstack(rows) ** 2, axis=0)) + 1e-12
    keep = list(active)
    x = np.vstack([(c[:, keep] / scale[keep, None]).reshape(-1, c.shape[2]) for c in columns])
    y = np.concatenate([(r[:, keep] / scale[keep]).ravel() for r in rows])
    size = np.sqrt(np.mean(x**2, axis=0)) + 1e-12
    x = x / size
    return np.asarray(np.linalg.solve(x.T @ x + RIDGE * len(y) * np.eye(x.shape[1]), x.T @ y) / size)


def _normal(columns: Floats, rows: Floats) -> tuple[Floats, Floats]:
    flat = columns.reshape(-1, columns.shape[2])
    return flat.T @ flat, flat.T @ rows.ravel()


def _biases(candidates: Sequence[Candidate]) -> Biases:
    """Columns of what sensors are specified to be off by: of effects with a sensor prior, one candidate each."""
    columns: list[int] = []
    information: list[float] = []
    taken: set[str] = set()
    for candidate in candidates:
        deviation = candidate.effect.sensor_prior
        if deviation is None or candidate.key in taken:
            continue
        taken.add(candidate.key)
        if candidate.whole:  # its column is the effect of the size at which it was tried
            deviation /= next(iter(candidate.at.values()))
        columns += candidate.columns
        information += [deviation**-2] * len(candidate.columns)
    return Biases(tuple(columns), np.array(information))
