"""The mock's errors of PX4's estimate for flights that have a plant of their own."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats
from sitl_mock.vehicle.estimator import PX4_WANDER, Drift, at_rest
from sitl_mock.vehicle.sensors import next_wander

STEP = 0.01  # s
DRAWN_EVERY = 50  # steps between two draws of the drifting offsets


class Px4Estimate:
    """(9,) errors of position, m, velocity, m/s, and attitude, rad, at a time, s, as an estimate of PX4's has them."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._drift = Drift(PX4_WANDER, self._random)
        self._constants = PX4_WANDER.constants()
        self._wander, self._rate = at_rest(PX4_WANDER, self._random)
        self._time, self._steps = float("nan"), 0
        self._offset, self._slope = self._drift.offset, np.zeros(9)

    def __call__(self, time: float) -> Floats:
        """The errors; times never go back."""
        if np.isnan(self._time):
            self._time = time
        while self._time < time - 0.5 * STEP:
            noise = self._random.standard_normal(9)
            self._wander, self._rate = next_wander(self._wander, self._rate, noise, self._constants, STEP)
            self._advance_offset()
            self._time += STEP
        return np.asarray(self._wander + self._offset)

    def _advance_offset(self) -> None:
        if self._steps % DRAWN_EVERY == 0:
            self._drift.advance(DRAWN_EVERY * STEP)
            self._slope = (self._drift.offset - self._offset) / DRAWN_EVERY
        self._offset = self._offset + self._slope
        self._steps += 1
