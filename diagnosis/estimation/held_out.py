"""Vehicles on held-out flights: their residuals, the floor, and how errors change from one vehicle to another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.data.workspace import Workspace, key_of
from diagnosis.estimation.channel_noise import ChannelNoise
from diagnosis.estimation.evaluation import residuals_in
from diagnosis.estimation.paired_errors import (
    ErrorChange,
    ModelErrors,
    channel_changes,
    differences,
    open_loop_changes,
    open_loop_total,
)
from diagnosis.models.open_loop import motion_over_horizons, open_loop_windows
from diagnosis.models.pose_errors import with_velocity_errors
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

OPEN_LOOP = "open-loop"
SEED = 2  # of the errors of velocity, the same for all vehicles


class HeldOut:
    """Segments on which vehicles are judged, under the noise of others.

    An estimator's error of velocity is force to a model with drag, so that the measured error rises where a drag that
    is there is added. Of squared errors of channels what such an error makes in each model is taken away.
    """

    def __init__(self, noise: ChannelNoise, segments: Sequence[Segment]) -> None:
        self.segments = segments
        self._noise, self._limits = noise, noise.thresholds.relevance
        self._workspace = Workspace()

    def rows(self, vehicle: Vehicle) -> list[Floats]:
        """(m, 12) residuals of each segment."""
        return self._workspace.get("rows", key_of(vehicle), lambda: residuals_in(self._noise, vehicle, self.segments))

    def floor(self, vehicle: Vehicle) -> Floats:
        """(12,) the noise's floor, at most the vehicle's own error."""
        return self._noise.floor_of(self.rows(vehicle))

    def sensors(self, vehicle: Vehicle) -> Floats:
        """(12,) the part of that floor that sensors make."""
        return np.minimum(self._noise.sensors, self.floor(vehicle))

    def channel_changes(self, before: Vehicle, after: Vehicle, floor: Floats) -> dict[str, ErrorChange]:
        """By kind of channel. floor: (12,) with which the changes are compared.

        Without the beginnings from which the hidden states' start is estimated, where either vehicle has such: what
        they tell of it is no proof.
        """
        was, now = map(self._row_errors, (before, after))
        if (skipped := self._skipped(before, after)) > 0:
            was, now = was.after(skipped), now.after(skipped)
        return channel_changes(was, now, floor, self._noise.rate, self._limits)

    def _row_errors(self, vehicle: Vehicle) -> ModelErrors:
        return self._workspace.get("row errors", key_of(vehicle), lambda: self._rows_and_pose(vehicle))

    def _window_errors(self, vehicle: Vehicle) -> dict[float, ModelErrors]:
        return self._workspace.get("windows", key_of(vehicle), lambda: self._windows_and_pose(vehicle))

    def _rows_and_pose(self, vehicle: Vehicle) -> ModelErrors:
        """Residuals, and what errors of the pose's velocity make of them."""
        rows = self.rows(vehicle)
        drawn = (residuals_in(self._noise, vehicle, one) for one in self._perturbed)
        return ModelErrors(rows, [differences(one, rows) for one in drawn])

    @cached_property
    def _perturbed(self) -> list[list[Segment]]:
        """The segments with errors of velocity as large as their own, once for each draw; none without such errors."""
        limits = self._noise.thresholds.pose
        if not self._noise.drifts:
            return []
        random = np.random.default_rng(SEED)
        return [with_velocity_errors(self.segments, random, limits) for _ in range(limits.draws)]

    def _skipped(self, *vehicles: Vehicle) -> int:
        """Rows from which the start of hidden states is estimated, if a vehicle has any that start freely."""
        catalogue, limits = self._noise.catalogue, self._noise.thresholds.prediction
        effects = [catalogue[use.name] for vehicle in vehicles for use in vehicle.effects]
        if not any(hidden.start_std for effect in effects for hidden in effect.hidden):
            return 0
        return round(limits.free_start_durations[-1] * self._noise.rate)

    def open_loop_changes(self, before: Vehicle, after: Vehicle) -> dict[str, ErrorChange]:
        """By quantity; empty without a pose.

        Without the position where an estimator makes the pose: after a second its error is that of the velocity at the
        start, to which the commands respond, so that a model whose rotors turn the vehicle too much comes closer.
        """
        was, now = map(self._window_errors, (before, after))
        if not was:
            return {}
        interval = self._noise.thresholds.prediction.start_interval
        compared = open_loop_changes(was, now, self._motion, interval, self._limits)
        estimated = any(segment.pose_source == "estimator" for segment in self.segments)
        return {quantity: c for quantity, c in compared.items() if not (estimated and quantity == "position")}

    def improvement(self, before: Vehicle, after: Vehicle) -> float:
        """Standard deviations by which all errors of the open loop together fall from one vehicle to another.

        Infinite where there is none to compare, and where the model before diverges.
        """
        quantities = list(self.open_loop_changes(before, after))
        if not quantities:
            return math.inf
        was, now = map(self._window_errors, (before, after))
        interval = self._noise.thresholds.prediction.start_interval
        return -open_loop_total(was, now, quantities, interval, self._limits).deviations

    @cached_property
    def _motion(self) -> dict[float, Floats]:
        return motion_over_horizons(self.segments, self._noise.thresholds.prediction)

    def open_loop(self, vehicle: Vehicle) -> dict[float, list[Floats]]:
        """(W, 12) errors of each segment's windows, by horizon; empty without a pose."""
        return {h: list(errors.rows) for h, errors in self._window_errors(vehicle).items()}

    def _simulated(self, vehicle: Vehicle, segments: Sequence[Segment]) -> dict[float, list[Floats]]:
        return open_loop_windows(vehicle, self._noise.catalogue, segments, self._noise.thresholds.prediction)

    def _windows_and_pose(self, vehicle: Vehicle) -> dict[float, ModelErrors]:
        """Errors of windows, by horizon, and what errors of the pose's velocity make of them."""
        windows, *drawn = (self._simulated(vehicle, segments) for segments in (self.segments, *self._perturbed))
        return {h: ModelErrors(own, [differences(draw[h], own) for draw in drawn]) for h, own in windows.items()}

    def worse(self, before: Vehicle, after: Vehicle) -> dict[str, ErrorChange]:
        """Errors that rise from one vehicle to another by what matters and by more than chance, by name."""
        return self.worse_channels(before, after) | self.worse_open_loop(before, after)

    def worse_channels(self, before: Vehicle, after: Vehicle) -> dict[str, ErrorChange]:
        """Kinds of channel whose error rises."""
        by_kind = self.channel_changes(before, after, self.floor(after))
        return {kind: change for kind, change in by_kind.items() if change.is_worse(self._limits)}

    def worse_open_loop(self, before: Vehicle, after: Vehicle) -> dict[str, ErrorChange]:
        """Quantities of the open loop whose error rises."""
        by_quantity = self.open_loop_changes(before, after)
        return {f"{OPEN_LOOP} {q}": c for q, c in by_quantity.items() if c.is_worse(self._limits)}
