"""Prediction of a model along a measured flight: specific force and angular acceleration at every row, or slopes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagnosis.data.filters import delayed
from diagnosis.data.segment import Segment
from dynamics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Prediction:
    """Prediction of a model along a segment, or a slope of it.

    specific_force: (n, 3) body, as the accelerometer would read it, m/s^2.
    angular_acceleration: (n, 3) in the gyro's axes, rad/s^2.
    rate: (n, 3) body, without the gyro's faults, rad/s.
    pose_force: (n, 3) specific force, without the accelerometer's faults, of the point whose pose is logged, in the
        logged attitude's axes, m/s^2.
    pose_age: delay of the pose, s, by which world acceleration and attitude rate are late.
    attitude_age: delay of the attitude beyond that, s.
    """

    specific_force: Floats
    angular_acceleration: Floats
    rate: Floats
    pose_force: Floats
    pose_age: float = 0.0
    attitude_age: float = 0.0

    def world_acceleration(self, segment: Segment) -> Floats:
        """(n, 3) acceleration less gravity that the pose shows, world, m/s^2."""
        force = delayed(self.pose_force, segment.rate, self.pose_age).T
        x, y, z = segment.axes_in_world
        return np.asarray((x * force[0] + y * force[1] + z * force[2]).T)

    def attitude_rate(self, segment: Segment) -> Floats:
        """(n, 3) body rate that the attitude shows, rad/s."""
        return delayed(self.rate, segment.rate, self.pose_age + self.attitude_age)

    @classmethod
    def from_outputs(cls, outputs: Floats, ages: Floats) -> Prediction:
        """From what `_outputs` computes, (n, 12). ages: of the pose, and of the attitude beyond it, s."""
        force, angular, rate, pose_force = (outputs[:, i : i + 3] for i in range(0, 12, 3))
        return cls(force, angular, rate, pose_force, float(ages[0]), float(ages[1]))
