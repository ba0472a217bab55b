"""Errors that healthy sensors have within specification: of all effects with a sensor prior, a user's own included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.data.workspace import Workspace
from diagnosis.models import channels
from diagnosis.selection.candidates import Candidate, make_candidates
from diagnosis.selection.design_matrix import DesignMatrix
from diagnosis.thresholds import Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Biases:
    """Unknowns with a prior that are marginalised: each flight's own errors, or what all flights share.

    columns: their places among the columns.
    information: their inverse prior variances.
    expected: prior means as distances from the point about which the columns are linear; None: zero.
    """

    columns: tuple[int, ...]
    information: Floats
    expected: Floats | None = None

    @property
    def pull(self) -> Floats:
        """Information times expected, which the prior adds to the product."""
        return np.zeros(len(self.columns)) if self.expected is None else self.information * self.expected


NO_BIASES = Biases((), np.zeros(0))


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
            deviation /= abs(next(iter(candidate.sizes.values())))
        columns += candidate.columns
        information += [deviation**-2] * len(candidate.columns)
    return Biases(tuple(columns), np.array(information))


class SensorErrors:
    """Columns of these errors for segments under a vehicle's model, and their standard deviations.

    segments: of which the first has the kinds of channel that all have.
    """

    def __init__(
        self, vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment], thresholds: Thresholds
    ) -> None:
        healthy = {name: effect for name, effect in catalogue.items() if effect.sensor_prior is not None}
        candidates = make_candidates(vehicle, healthy, segments)
        biases = sensor_biases(candidates)
        self.deviation = biases.information**-0.5
        self._places = list(biases.columns)
        self._design = (
            DesignMatrix(vehicle, catalogue, candidates, segments[0], thresholds.prediction) if candidates else None
        )
        self._workspace = Workspace()

    def columns(self, segment: Segment) -> Floats:
        """(m, 12, k) of a segment."""
        if self._design is None:
            return np.zeros((len(segment.position[segment.decimated]), channels.CHANNELS, 0))
        design = self._design

        def columns() -> Floats:
            return design.evaluate(segment, instrumented=False)[1][:, :, self._places]

        return self._workspace.get("columns", segment.digest, columns)
