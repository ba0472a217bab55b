"""The estimated velocity, made consistent with the slope of the estimated position. Pure.

An EKF on satellites and an accelerometer errs by some 0.3 m/s for seconds on end, and its position does not follow its
velocity: it is pulled back to what is measured. The slope of the position errs by half of that
(benchmarks/results/px4_tracking.md), so the slow part of the velocity is taken from it.
"""

from __future__ import annotations

from math import sqrt

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.state import VELOCITY
from runtime.link.estimate import StateEstimate

TIME = 0.3  # s within which the velocity's mean comes to follow the position's slope
MAX_GAP = 0.1  # s between two estimates, beyond which their slope says nothing
MAX_MISMATCH = 2.0  # m/s of one slope that counts: a position that steps is no motion
MAX_CORRECTION = 1.0  # m/s


class ConsistentVelocity:
    """Corrects estimates by the running mean of the difference between slope of position and velocity.

    correction: (3,) m/s, world, of the last estimate.
    before: the last estimate as it was received, None before the first.
    """

    def __init__(self) -> None:
        self.correction: Floats = np.zeros(3)
        self.before: StateEstimate | None = None

    def correct(self, estimate: StateEstimate, *, moved: bool) -> StateEstimate:
        """An estimate with its velocity corrected. moved: whether the estimator has moved its frame since the last."""
        before, self.before = self.before, estimate
        if before is not None and not moved and 1e-3 < estimate.time - before.time < MAX_GAP:
            self._learn(before, estimate)
        state = estimate.state.copy()
        state[VELOCITY] += self.correction
        return msgspec.structs.replace(estimate, state=state)

    def _learn(self, before: StateEstimate, now: StateEstimate) -> None:
        elapsed = now.time - before.time
        mean = 0.5 * (before.velocity_world + now.velocity_world)
        mismatch = (now.position_world - before.position_world) / elapsed - mean
        share = min(elapsed / TIME, 1.0)
        self.correction = self.correction + share * (_limited(mismatch, MAX_MISMATCH) - self.correction)
        self.correction = _limited(self.correction, MAX_CORRECTION)


def _limited(vector: Floats, length: float) -> Floats:
    """A vector no longer than a length; in plain numbers, as `alula_tick` has the same to the last bit."""
    x, y, z = vector.tolist()
    return vector * min(1.0, length / max(sqrt(x * x + y * y + z * z), 1e-9))
