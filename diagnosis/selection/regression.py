"""The regression: one whitened Gram matrix a flight, from which everything else is small linear algebra.

Every flight has its own clock offset, gyro's bias and accelerometer's bias, with the sensors' specification as their
prior: millisecond offsets are otherwise the most frequent false alarm. They are marginalised at once, so that a fault
of a sensor is what all flights share beyond them.

Where only commands were logged, the gain and the curve from command to thrust are unknowns that all flights share. They
are marginalised in every solution, so that drag, mass and inertia compete with them on equal terms.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.segment import Segment
from diagnosis.models.pose_errors import NO_ERRORS, PoseErrors
from diagnosis.selection.candidates import Candidate
from diagnosis.selection.design_matrix import DesignMatrix
from diagnosis.selection.noise import NoiseModel
from diagnosis.selection.sensor_errors import NO_BIASES, Biases, SensorErrors
from diagnosis.thresholds import DEFAULT, Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class FlightEquations:
    """One flight's normal equations, its biases among the columns.

    gram, product: (k, k) and (k,) with errors-in-variables correction.
    plain_gram, plain_product: without.
    """

    gram: Floats
    product: Floats
    plain_gram: Floats
    plain_product: Floats


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
    saturated: (m, 12) residuals after all columns at once, by digest of the segments for which they were asked.
    equations: of each flight.
    pose: errors of the segments' pose that are noise.
    errors: of rows (m, 12) and columns (m, 12, k) that noise added to a segment causes, a segment each.
    noisier: the segments with noise added.
    thresholds: for all that is built on this regression.
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
    noisier: Sequence[Segment] = ()
    thresholds: Thresholds = DEFAULT
    not_followed: tuple[str, ...] = ()
    nuisances: tuple[Candidate, ...] = ()
    shared: Biases = NO_BIASES
    saturated: dict[bytes, Floats] = field(default_factory=dict)

    @cached_property
    def sensor_errors(self) -> SensorErrors:
        """Errors of the sensors within specification, for any segment."""
        return SensorErrors(self.vehicle, self.catalogue, self.segments, self.thresholds)

    def saturated_residual(self, segment: Segment) -> Floats:
        """(m, 12) residual of any segment after all columns at once, which all trials of effects have in common."""
        if segment.digest not in self.saturated:
            rows, columns = self.design.evaluate(segment)
            self.saturated[segment.digest] = rows - columns @ self.everything
        return self.saturated[segment.digest]

    @property
    def flights(self) -> range:
        """The flights by number."""
        return range(len(self.gram))

    @property
    def total(self) -> int:
        """Number of whitened residuals."""
        return sum(self.observations)

    def solve(self, chosen: Sequence[int], *, plain: bool = False) -> tuple[Floats, float]:
        """Coefficients of the chosen columns, and twice the log-likelihood that they gain.

        plain: without errors-in-variables correction.
        """
        where = list(chosen)
        if not where:
            return np.zeros(0), 0.0
        theta, gain = solved(*self._free_of_shared(where, plain=plain))
        return theta, float(gain)

    @cached_property
    def _stacked(self) -> tuple[Floats, Floats, Floats, Floats]:
        gram, product = np.stack(self.gram), np.stack(self.product)
        return gram, product, np.stack(self.plain_gram), np.stack(self.plain_product)

    def _sums(
        self, places: Sequence[int], weights: Floats | None = None, *, plain: bool = False
    ) -> tuple[Floats, Floats]:
        """(.., p, p) and (.., p) normal equations of the columns at some places, summed over flights.

        weights: (.., f) how often each flight counts; by default once.
        """
        grams, products = self._stacked[2:] if plain else self._stacked[:2]
        grams, products = grams[np.ix_(self.flights, places, places)], products[:, places]
        if weights is None:
            return grams.sum(axis=0), products.sum(axis=0)
        return np.tensordot(weights, grams, axes=1), weights @ products

    def gain(self, chosen: Sequence[int]) -> float:
        """Twice the log-likelihood that the chosen columns gain beyond the biases."""
        return self.solve(chosen)[1]

    def _free_of_shared(
        self, where: Sequence[int], weights: Floats | None = None, *, plain: bool = False
    ) -> tuple[Floats, Floats]:
        """The sums of some columns, with what the flights share marginalised."""
        count, every = len(where), [*where, *self.shared.columns]
        shared = replace(self.shared, columns=tuple(range(count, len(every))))
        gram, product = marginal(*self._sums(every, weights, plain=plain), shared)
        return gram[..., :count, :count], product[..., :count]


def solved(gram: Floats, product: Floats) -> tuple[Floats, Floats]:
    """Solutions (..., p) of normal equations (..., p, p) and (..., p), and their gains (...)."""
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 1e-9))
    matrix = gram / (scale[..., :, None] * scale[..., None, :]) + 1e-8 * np.eye(gram.shape[-1])
    theta = np.linalg.solve(matrix, (product / scale)[..., None])[..., 0] / scale
    return theta, np.sum(theta * product, axis=-1)


def marginals(grams: Sequence[Floats], products: Sequence[Floats], biases: Biases) -> tuple[list[Floats], list[Floats]]:
    """`marginal` of each flight."""
    return unzipped(marginal(gram, product, biases) for gram, product in zip(grams, products, strict=True))


def unzipped(pairs: Iterable[tuple[Floats, Floats]]) -> tuple[list[Floats], list[Floats]]:
    """Two lists of a list of pairs."""
    first, second = zip(*pairs, strict=True)
    return list(first), list(second)


def marginal(gram: Floats, product: Floats, biases: Biases) -> tuple[Floats, Floats]:
    """Normal equations (.., k, k) and (.., k) with biases integrated out under their prior."""
    places = list(biases.columns)
    if not places:
        return gram, product
    across = gram[..., places, :]
    inner = across[..., places] + np.diag(biases.information)
    solved = np.linalg.solve(inner, np.concatenate([across, (product[..., places] + biases.pull)[..., None]], axis=-1))
    less = gram[..., places] @ solved
    return gram - less[..., :-1], product - less[..., -1]


def explained_by_biases(gram: Floats, product: Floats, biases: Biases) -> Floats:
    """(..) twice the log-likelihood that one flight's biases gain, less what a gust takes off their certainty."""
    places = list(biases.columns)
    if not places:
        return np.zeros(product.shape[:-1])
    inner = gram[..., places, :][..., places] + np.diag(biases.information)
    estimates = np.linalg.solve(inner, product[..., places, None])[..., 0]
    return np.asarray(np.sum(product[..., places] * estimates, axis=-1) - np.linalg.slogdet(inner)[1])
