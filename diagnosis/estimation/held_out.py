"""Vehicles on held-out flights: their residuals, the floor, and how errors change from one vehicle to another."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.estimation.evaluation import residual_floor, residuals_in, saturated_floor
from diagnosis.estimation.paired_errors import (
    ErrorChange,
    ModelErrors,
    channel_changes,
    differences,
    open_loop_changes,
)
from diagnosis.models.open_loop import open_loop_windows
from diagnosis.models.pose_errors import with_velocity_errors
from diagnosis.selection.regression import Regression
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

SEED = 2  # of the errors of velocity, the same for all vehicles


class HeldOut:
    """Segments on which vehicles are judged, under the noise of one regression of others.

    An estimator's error of velocity is force to a model with drag, so that the measured error rises where a drag that
    is there is added. Of squared errors of channels what such an error makes in each model is taken away.
    """

    def __init__(self, regression: Regression, segments: Sequence[Segment]) -> None:
        self.segments = segments
        self._regression, self._limits = regression, regression.thresholds.relevance
        self._saturated_floor = saturated_floor(regression, segments)
        self._rows: dict[int, tuple[Vehicle, list[Floats]]] = {}
        self._windows: dict[int, tuple[Vehicle, dict[float, list[Floats]]]] = {}
        self._row_errors: dict[int, tuple[Vehicle, ModelErrors]] = {}
        self._window_errors: dict[int, tuple[Vehicle, dict[float, ModelErrors]]] = {}

    def rows(self, vehicle: Vehicle) -> list[Floats]:
        """(m, 12) residuals of each segment."""
        if id(vehicle) not in self._rows:
            self._rows[id(vehicle)] = (vehicle, residuals_in(self._regression, vehicle, self.segments))
        return self._rows[id(vehicle)][1]

    def floor(self, vehicle: Vehicle) -> Floats:
        """(12,) noise floor: of the residuals after all columns of the catalogue, or of the vehicle where lower."""
        return np.minimum(self._saturated_floor, residual_floor(self._regression, self.rows(vehicle)))

    def channel_changes(self, before: Vehicle, after: Vehicle, floor: Floats) -> dict[str, ErrorChange]:
        """By kind of channel. floor: (12,) with which the changes are compared.

        Without the beginnings from which the hidden states' start is estimated, where either vehicle has such: what
        they tell of it is no proof.
        """
        was, now = (self._rows_and_pose(vehicle) for vehicle in (before, after))
        if (skipped := self._skipped(before, after)) > 0:
            was, now = was.after(skipped), now.after(skipped)
        return channel_changes(was, now, floor, self._regression.rate, self._limits)

    def _rows_and_pose(self, vehicle: Vehicle) -> ModelErrors:
        """Residuals, and what errors of the pose's velocity make of them."""
        if id(vehicle) not in self._row_errors:
            rows, r = self.rows(vehicle), self._regression
            drawn = [differences(residuals_in(r, vehicle, segments), rows) for segments in self._erring]
            self._row_errors[id(vehicle)] = (vehicle, ModelErrors(rows, drawn))
        return self._row_errors[id(vehicle)][1]

    @cached_property
    def _erring(self) -> list[list[Segment]]:
        """The segments with errors of velocity as large as their own, once for each draw; none without such errors."""
        limits = self._regression.thresholds.pose
        if not self._regression.pose.there:
            return []
        random = np.random.default_rng(SEED)
        return [with_velocity_errors(self.segments, random, limits) for _ in range(limits.draws)]

    def _skipped(self, *vehicles: Vehicle) -> int:
        """Rows from which the start of hidden states is estimated, if a vehicle has any that start freely."""
        catalogue, limits = self._regression.catalogue, self._regression.thresholds.prediction
        effects = [catalogue[use.name] for vehicle in vehicles for use in vehicle.effects]
        if not any(hidden.start_std for effect in effects for hidden in effect.hidden):
            return 0
        return round(limits.free_start_durations[-1] * self._regression.rate)

    def open_loop_changes(self, before: Vehicle, after: Vehicle) -> dict[tuple[float, str], ErrorChange]:
        """By horizon, s, and quantity; empty without a pose.

        Without the position where an estimator makes the pose: after a second its error is that of the velocity at the
        start, to which the commands respond, so that a model whose rotors turn the vehicle too much comes closer.
        """
        interval = self._regression.thresholds.prediction.start_interval
        was, now = self._windows_and_pose(before), self._windows_and_pose(after)
        compared = open_loop_changes(was, now, interval, self._limits)
        estimated = any(segment.pose_source == "estimator" for segment in self.segments)
        return {place: c for place, c in compared.items() if not (estimated and place[1] == "position")}

    def open_loop(self, vehicle: Vehicle) -> dict[float, list[Floats]]:
        """(W, 12) errors of each segment's windows, by horizon; empty without a pose."""
        if id(vehicle) not in self._windows:
            self._windows[id(vehicle)] = (vehicle, self._simulated(vehicle, self.segments))
        return self._windows[id(vehicle)][1]

    def _simulated(self, vehicle: Vehicle, segments: Sequence[Segment]) -> dict[float, list[Floats]]:
        regression = self._regression
        return open_loop_windows(vehicle, regression.catalogue, segments, regression.thresholds.prediction)

    def _windows_and_pose(self, vehicle: Vehicle) -> dict[float, ModelErrors]:
        """Errors of windows, by horizon, and what errors of the pose's velocity make of them."""
        if id(vehicle) not in self._window_errors:
            windows, drawn = self.open_loop(vehicle), [self._simulated(vehicle, s) for s in self._erring]
            errors = {h: ModelErrors(own, [differences(d[h], own) for d in drawn]) for h, own in windows.items()}
            self._window_errors[id(vehicle)] = (vehicle, errors)
        return self._window_errors[id(vehicle)][1]

    def worse(self, before: Vehicle, after: Vehicle) -> dict[str, ErrorChange]:
        """Errors that rise from one vehicle to another by what matters and by more than chance, by name."""
        return self.worse_channels(before, after) | self.worse_open_loop(before, after)

    def larger(self, vehicle: Vehicle, before: Vehicle, after: Vehicle) -> dict[str, ErrorChange]:
        """Errors that are larger by what matters, be it chance, by name: of channels and of the open loop.

        before: the vehicle with the sensors' faults of the other, for the open loop, whose motion these do not change.
        """
        ratio = 1.0 + self._limits.max_rise
        errors = self.channel_changes(vehicle, after, self.floor(after))
        errors |= {f"{q} after {h:g} s": c for (h, q), c in self.open_loop_changes(before, after).items()}
        return {name: change for name, change in errors.items() if change.after > ratio * change.before}

    def worse_channels(self, before: Vehicle, after: Vehicle) -> dict[str, ErrorChange]:
        """The same of the kinds of channel."""
        by_kind = self.channel_changes(before, after, self.floor(after))
        return {kind: change for kind, change in by_kind.items() if change.is_worse(self._limits)}

    def worse_open_loop(self, before: Vehicle, after: Vehicle) -> dict[str, ErrorChange]:
        """The same of the open loop."""
        by_place = self.open_loop_changes(before, after)
        return {f"{q} after {h:g} s": c for (h, q), c in by_place.items() if c.is_worse(self._limits)}
