"""Whether a vehicle under rising thrust has left the ground, by the likelihood of what its accelerometer shows. Pure.

On the ground the vertical specific force is gravity's, whatever the thrust. From the moment of lift-off on it is
gravity's times the thrust over the thrust of that moment, which leaves nothing to fit but the moment. Neither noise
nor the estimate, which integrates that noise and climbs with it, follows thrust in this way.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from runtime.flight.thrust import MAX_FILE_ERROR, MIN_FILE_ERROR

WINDOW = 1.0  # s of samples that are kept
MIN_NOISE = 1.5  # m/s^2 of a sample, standard deviation; more where successive samples differ by more
NEVER = -np.inf


class LiftOffEvidence:
    """The log likelihood ratio of having lifted off to still standing, at the likeliest moment.

    ratio: that; minus infinity where no moment is possible, since thrust could not have carried the vehicle then.
    effectiveness: thrust per modelled thrust since that moment; 1 without one.
    measured: whether an accelerometer was.
    """

    def __init__(self, weight: float) -> None:
        """weight: N."""
        self._weight = weight
        self._samples: deque[tuple[float, float, float]] = deque()
        self.ratio, self.effectiveness, self.measured = NEVER, 1.0, False

    def add(self, time: float, thrust: float, specific_force: float) -> None:
        """Add a sample.

        time: s. thrust: modelled, that acts at that time, N. specific_force: vertical, m/s^2.
        """
        self.measured = True
        self._samples.append((time, thrust, specific_force))
        while self._samples[0][0] < time - WINDOW:
            self._samples.popleft()
        if thrust * MAX_FILE_ERROR < self._weight or len(self._samples) < 3:
            return
        _, thrusts, forces = np.array(self._samples).T
        ratios = self._ratios(thrusts, forces)
        likeliest = int(np.argmax(ratios))
        self.ratio = float(ratios[likeliest])
        if self.ratio > NEVER:
            since, felt = thrusts[likeliest:], forces[likeliest:]
            gain = float(felt @ since / (since @ since)) * self._weight / GRAVITY
            self.effectiveness = min(max(gain, MIN_FILE_ERROR), MAX_FILE_ERROR)

    def _ratios(self, thrusts: Floats, forces: Floats) -> Floats:
        """Log likelihood ratio of having lifted off at each sample, (n,)."""
        variance = max(MIN_NOISE**2, 0.5 * float(np.mean(np.diff(forces) ** 2)))
        excess = forces - GRAVITY
        products = [excess * thrusts, excess, thrusts**2, thrusts, np.ones_like(thrusts)]
        both, alone, squared, linear, count = np.cumsum(np.array(products)[:, ::-1], axis=1)[:, ::-1]
        start = np.maximum(thrusts, 1e-6)
        explained = GRAVITY * (both / start - alone)
        power = GRAVITY**2 * (squared / start**2 - 2 * linear / start + count)
        possible = (start * MAX_FILE_ERROR >= self._weight) & (start * MIN_FILE_ERROR <= self._weight)
        return np.where(possible, (explained - 0.5 * power) / variance, NEVER)
