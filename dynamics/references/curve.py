"""Curves in position and yaw, as smooth functions of a phase, with their derivatives in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynamics.arrays import Floats

DERIVATIVES = 5  # position to snap: what body rates, angular accelerations and rotor speeds need
FLAT = 4  # x, y, z, yaw


class Curve(Protocol):
    """Flat outputs (x, y, z, yaw) as a function of phase, four times continuously differentiable."""

    def derivatives(self, phase: Floats) -> Floats:
        """The flat outputs and their first four derivatives. phase: (n,). Returns (n, 5, 4): m and rad."""
        ...


@dataclass(frozen=True, slots=True)
class HarmonicCurve:
    """A finite Fourier series over the phase, rad, plus a constant drift (continued yaw spins).

    cosine, sine: (harmonics + 1, 4), row k belongs to cos k phase and sin k phase.
    drift: (4,) per rad.
    """

    cosine: Floats
    sine: Floats
    drift: Floats

    def derivatives(self, phase: Floats) -> Floats:
        """The flat outputs and their first four derivatives. phase: (n,) rad. Returns (n, 5, 4)."""
        harmonic = np.arange(len(self.cosine))
        angle = phase[:, None] * harmonic
        cos, sin = np.cos(angle), np.sin(angle)
        result = np.empty((phase.size, DERIVATIVES, FLAT))
        for order in range(DERIVATIVES):
            weight = harmonic.astype(float) ** order
            result[:, order] = (cos * weight) @ self.cosine + (sin * weight) @ self.sine
            cos, sin = -sin, cos
        result[:, 0] += phase[:, None] * self.drift
        result[:, 1] += self.drift
        return result


@dataclass(frozen=True, slots=True)
class PiecewisePolynomial:
    """Polynomials between breaks of the phase, s; outside the breaks the first and last values hold.

    breaks: (m + 1,) increasing.
    coefficients: (m, degree + 1, 4), ascending powers of the phase since the preceding break.
    """

    breaks: Floats
    coefficients: Floats

    def derivatives(self, phase: Floats) -> Floats:
        """The flat outputs and their first four derivatives. phase: (n,) s. Returns (n, 5, 4)."""
        clipped = np.clip(phase, self.breaks[0], self.breaks[-1])
        interval = np.clip(np.searchsorted(self.breaks, clipped, side="right") - 1, 0, len(self.coefficients) - 1)
        since = (clipped - self.breaks[interval])[:, None]
        result = np.empty((phase.size, DERIVATIVES, FLAT))
        coefficients = self.coefficients
        for order in range(DERIVATIVES):
            value = np.zeros((phase.size, FLAT))
            for power in range(coefficients.shape[1] - 1, -1, -1):
                value = value * since + coefficients[interval, power]
            result[:, order] = value
            coefficients = coefficients[:, 1:] * np.arange(1, coefficients.shape[1])[None, :, None]
        return result


# rest to rest with four vanishing derivatives at both ends
_REST_TO_REST = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 126.0, -420.0, 540.0, -315.0, 70.0])
REST_TO_REST_SPEED = 315 / 128  # peak speed of a unit move in unit time
REST_TO_REST_ACCELERATION = 9.372  # peak acceleration of a unit move in unit time


def rest_to_rest(points: Floats, durations: Floats) -> PiecewisePolynomial:
    """Moves from point to point that start and end at rest; equal neighbours make a pause.

    points: (m + 1, 4) x, y, z in m and yaw in rad. durations: (m,) s.
    """
    steps = np.diff(points, axis=0)
    powers = np.arange(len(_REST_TO_REST))
    coefficients = _REST_TO_REST[None, :, None] * steps[:, None, :] / durations[:, None, None] ** powers[None, :, None]
    coefficients[:, 0] += points[:-1]
    return PiecewisePolynomial(np.concatenate([[0.0], np.cumsum(durations)]), coefficients)
