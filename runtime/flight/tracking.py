"""Tracking errors: the vehicle's own estimates against the reference at their times."""

from __future__ import annotations

from math import nan, sqrt

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, POSITION, VELOCITY
from runtime.flight.phases import Path, PhasePolicy
from runtime.link.estimate import StateEstimate


class TrackingReport(msgspec.Struct, frozen=True):
    """Errors while a reference was tracked.

    samples: estimates.
    position_rmse: m, of the norm.
    position_rmse_axes: m, of the world axes.
    position_max: m.
    velocity_rmse: m/s.
    attitude_rmse: rad.
    speed_max: m/s, the vehicle's.
    """

    samples: int
    position_rmse: float
    position_rmse_axes: tuple[float, float, float]
    position_max: float
    velocity_rmse: float
    attitude_rmse: float
    speed_max: float


class Tracking:
    """Sums of squared errors while a reference is tracked; each estimate counts once."""

    def __init__(self) -> None:
        self.samples = 0
        self.position_max = 0.0
        self.speed_max = 0.0
        self._position = np.zeros(3)
        self._velocity = 0.0
        self._attitude = 0.0
        self._last: StateEstimate | None = None

    def add(self, policy: PhasePolicy, estimate: StateEstimate, reference: Floats) -> None:
        """Add an estimate and the reference's state (13,) at the estimate's time. policy: of the present phase."""
        if policy.path is not Path.REFERENCE or estimate is self._last:
            return
        self._last = estimate
        self.samples += 1
        error = estimate.position_world - reference[POSITION]
        self._position += error * error
        self.position_max = max(self.position_max, float(np.linalg.norm(error)))
        self.speed_max = max(self.speed_max, float(np.linalg.norm(estimate.velocity_world)))
        self._velocity += float(np.sum((estimate.velocity_world - reference[VELOCITY]) ** 2))
        self._attitude += float(quaternion.angle_between(estimate.attitude, reference[ATTITUDE])) ** 2

    def report(self) -> TrackingReport:
        """Root mean square errors; all NaN without samples."""
        count = self.samples or nan
        axes = np.sqrt(self._position / count)
        return TrackingReport(
            samples=self.samples,
            position_rmse=sqrt(float(np.sum(self._position)) / count),
            position_rmse_axes=(float(axes[0]), float(axes[1]), float(axes[2])),
            position_max=self.position_max,
            velocity_rmse=sqrt(self._velocity / count),
            attitude_rmse=sqrt(self._attitude / count),
            speed_max=self.speed_max,
        )
