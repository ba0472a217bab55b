"""Errors of an estimate that drifts smoothly, in the air and at rest, as an EKF on GPS and accelerometer does."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats

WAVES = 4


class DriftingEstimate:
    """(9,) errors of position, m, velocity, m/s, and attitude, rad, at a time: sums of slow waves of random phase.

    Not a model of any estimator: its size and slowness are those that PX4's was measured to have, its law is not.
    """

    def __init__(self, seed: int, *, start_height: float = 0.0, share: float = 1.0) -> None:
        """start_height: m, constant error of the height. share: of the errors measured on PX4."""
        random = np.random.default_rng(seed)
        deviation = np.array([0.15, 0.11, 0.24, 0.23, 0.18, 0.14, 0.012, 0.012, 0.010])
        self._amplitude = share * deviation[:, None] * np.sqrt(2 / WAVES) * random.uniform(0.7, 1.3, (9, WAVES))
        self._frequency = random.uniform(0.15, 0.9, (9, WAVES))  # rad/s, periods of 7 to 40 s
        self._phase = random.uniform(0.0, 2 * np.pi, (9, WAVES))
        self._start_height = start_height

    def __call__(self, time: float) -> Floats:
        """The errors at a time, s."""
        error = np.sum(self._amplitude * np.sin(self._frequency * time + self._phase), axis=1)
        error[2] += self._start_height
        return np.asarray(error)
