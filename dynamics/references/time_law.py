"""Time laws: a phase that starts from rest, runs at a constant rate and comes to rest again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray

from dynamics.arrays import Floats

# The smoothstep with three vanishing derivatives at both ends: its use as a rate keeps the phase four times
# differentiable, so that position to snap, and with them the rotor speeds, are continuous from hover to hover.
_STEP = Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
_STEP_DERIVATIVES = (_STEP.integ(), _STEP, _STEP.deriv(1), _STEP.deriv(2), _STEP.deriv(3))


@dataclass(frozen=True, slots=True)
class TimeLaw:
    """Phase over time; before t = 0 and after the duration it is constant.

    rate: phase per s at full speed.
    ramp: s, at most half of the duration.
    duration: s.
    start: phase at t = 0.
    """

    rate: float
    ramp: float
    duration: float
    start: float = 0.0

    @property
    def end(self) -> float:
        """Phase at which the motion comes to rest."""
        return self.start + self.rate * (self.duration - self.ramp)

    def phase(self, times: ArrayLike) -> Floats:
        """Phase and its first four time derivatives. times: (n,) s. Returns (n, 5)."""
        t = np.clip(np.asarray(times, dtype=float), 0.0, self.duration)
        result = np.zeros((t.size, 5))
        result[:, 0] = self.start + self.rate * (t - self.ramp / 2)
        result[:, 1] = self.rate
        if self.ramp > 0:
            self._fill_ramp(result, t < self.ramp, t, forward=True)
            self._fill_ramp(result, t > self.duration - self.ramp, self.duration - t, forward=False)
        return result

    def _fill_ramp(self, result: Floats, rows: NDArray[np.bool_], since_rest: Floats, *, forward: bool) -> None:
        """Overwrite the rows of one ramp; the way out is the way in, mirrored in time."""
        part = since_rest[rows] / self.ramp
        for order, step in enumerate(_STEP_DERIVATIVES):
            value = self.rate * self.ramp ** (1 - order) * step(part)
            result[rows, order] = value if forward or order % 2 else -value
        result[rows, 0] += self.start if forward else self.end


def travel(curve: Floats, phase: Floats) -> Floats:
    """Time derivatives of a curve under a time law (Faa di Bruno's formula, orders 0 to 4).

    curve: (n, 5, k) derivatives with respect to phase, order on axis 1. phase: (n, 5). Returns (n, 5, k).
    """
    first, second, third, fourth = (phase[:, order, None] for order in range(1, 5))
    c0, c1, c2, c3, c4 = (curve[:, order] for order in range(5))
    return np.stack(
        [
            c0,
            c1 * first,
            c2 * first**2 + c1 * second,
            c3 * first**3 + 3 * c2 * first * second + c1 * third,
            c4 * first**4 + 6 * c3 * first**2 * second + c2 * (3 * second**2 + 4 * first * third) + c1 * fourth,
        ],
        axis=1,
    )
