"""Errors that healthy sensors have within specification: of all effects with a sensor prior, a user's own included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.data.workspace import Workspace
from diagnosis.models import channels
from diagnosis.models.predictor import Predictor
from diagnosis.selection.candidates import Candidate, make_candidates, without
from diagnosis.thresholds import Thresholds
from dynamics.arrays import Floats
from dynamics.effect import Effect
from dynamics.vehicle import Vehicle


class SensorErrors:
    """Columns of these errors for segments under a vehicle's model, and their standard deviations.

    segments: of which the first has the kinds of channel that all have.
    """

    def __init__(
        self, vehicle: Vehicle, catalogue: Mapping[str, Effect], segments: Sequence[Segment], thresholds: Thresholds
    ) -> None:
        healthy = {name: effect for name, effect in catalogue.items() if effect.sensor_prior is not None}
        self._candidates = _first_of_each(make_candidates(vehicle, healthy, segments))
        self._vehicle, self._catalogue, self._thresholds = vehicle, catalogue, thresholds
        self._measured = segments[0].rotor_source == "measured"
        self.deviation = np.array([std for c in self._candidates for std in _deviations(c)])
        self._workspace = Workspace()

    def columns(self, segment: Segment) -> Floats:
        """(m, 12, k) of a segment."""
        if not self._candidates:
            return np.zeros((len(segment.position[segment.decimated]), channels.CHANNELS, 0))
        return self._workspace.get("columns", segment.digest, lambda: self._columns(segment))

    def _columns(self, segment: Segment) -> Floats:
        """Slopes at the values of a healthy sensor, or the change by a size that is tried where an effect has none."""
        parts = []
        for candidate in self._candidates:
            with_it = self._predictor(candidate)
            if candidate.free:
                parts.append(channels.predicted(segment, with_it.slopes(segment, candidate.values)))
                continue
            size = next(iter(candidate.sizes.values()))
            there = channels.predicted(segment, [with_it.predict(segment, candidate.values)])
            parts.append((there - channels.predicted(segment, [self._bare.predict(segment)])) / size)
        return np.concatenate(parts, axis=2)

    @property
    def _bare(self) -> Predictor:
        return self._workspace.get("bare", None, lambda: self._make(None))

    def _predictor(self, candidate: Candidate) -> Predictor:
        return self._workspace.get("predictor", candidate.key, lambda: self._make(candidate))

    def _make(self, candidate: Candidate | None) -> Predictor:
        """The vehicle's model, with a candidate in it."""
        uses = self._vehicle.effects if candidate is None else (*without(self._vehicle, candidate), candidate.use())
        free = () if candidate is None else tuple(f"{candidate.key}.{name}" for name in candidate.free)
        limits = self._thresholds.prediction
        return Predictor(self._vehicle, uses, self._catalogue, free, speed_measured=self._measured, thresholds=limits)


def _first_of_each(candidates: Sequence[Candidate]) -> list[Candidate]:
    """One candidate of each effect: where it is tried at several points, the first."""
    first: dict[str, Candidate] = {}
    for candidate in candidates:
        first.setdefault(candidate.key, candidate)
    return list(first.values())


def _deviations(candidate: Candidate) -> list[float]:
    """Standard deviations of a candidate's parameters within specification."""
    assert candidate.effect.sensor_prior is not None
    return [candidate.effect.sensor_prior] * max(1, len(candidate.free))
