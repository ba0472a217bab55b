"""A reference: a curve, its time law, and the vehicle that tracks it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from dynamics.arrays import Floats
from dynamics.references.curve import Curve
from dynamics.references.flatness import ReferenceSamples, flat_motion
from dynamics.references.time_law import TimeLaw, travel
from dynamics.state import ATTITUDE
from dynamics.vehicle import Vehicle

# Linear interpolation over 2 ms errs by h^2/8 of the second derivative: 9 um in position at 18 m/s^2, 3e-5 rad in
# attitude at 55 rad/s^2. The table costs 70 kB per second of flight.
TABLE_STEP = 0.002


@dataclass(frozen=True, slots=True)
class Reference:
    """A smooth motion from hover to hover; before it starts and after it ends the vehicle hovers in place.

    curve and law make position and yaw, four times continuously differentiable in time; flatness on the vehicle
    makes the rest. States and inputs are tabulated on creation, so that a control tick reads its window cheaply.

    speed: factor on the speed that the manoeuvre of this name has, None for a motion that has no such factor.
    """

    name: str
    curve: Curve
    law: TimeLaw
    vehicle: Vehicle
    speed: float | None = None
    _states: Floats = field(init=False, repr=False, compare=False)
    _inputs: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Tabulate states and inputs."""
        count = int(np.ceil(self.law.duration / TABLE_STEP)) + 2
        samples = self.sample(np.arange(count) * TABLE_STEP)
        states = np.hstack([samples.position, samples.velocity, samples.attitude, samples.rate_body])
        object.__setattr__(self, "_states", states)
        object.__setattr__(self, "_inputs", samples.rotor_speed)

    @property
    def duration(self) -> float:
        """Time from hover to hover, s."""
        return self.law.duration

    def flat_outputs(self, times: ArrayLike) -> Floats:
        """Position (m) and yaw (rad) with four time derivatives. times: (n,) s. Returns (n, 5, 4)."""
        phase = self.law.phase(np.atleast_1d(np.asarray(times, dtype=float)))
        return travel(self.curve.derivatives(phase[:, 0]), self._at_rest_outside(times, phase))

    def sample(self, times: ArrayLike) -> ReferenceSamples:
        """The motion at any times, evaluated exactly. times: (n,) s, any order."""
        times = np.atleast_1d(np.asarray(times, dtype=float))
        return flat_motion(times, self.flat_outputs(times), self.vehicle)

    def states(self, times: ArrayLike) -> Floats:
        """Position and velocity (world), attitude, body rates, from the table. times: (n,) s. Returns (n, 13)."""
        result = _interpolate(self._states, times)
        attitude = result[:, ATTITUDE]
        attitude /= np.sqrt(np.einsum("ij,ij->i", attitude, attitude))[:, None]
        return result

    def inputs(self, times: ArrayLike) -> Floats:
        """Rotor speeds, rad/s, from the table. times: (n,) s. Returns (n, rotors)."""
        return _interpolate(self._inputs, times)

    def _at_rest_outside(self, times: ArrayLike, phase: Floats) -> Floats:
        """The phase law with vanishing derivatives outside of [0, duration]: a law without ramps stops there."""
        t = np.atleast_1d(np.asarray(times, dtype=float))
        outside = (t < 0) | (t > self.law.duration)
        phase[outside, 1:] = 0.0
        return phase


def _interpolate(table: Floats, times: ArrayLike) -> Floats:
    """Rows of a table of step TABLE_STEP at any times, the first and last row held outside. Returns (n, columns)."""
    place = np.minimum(np.maximum(np.asarray(times, dtype=float) * (1 / TABLE_STEP), 0.0), len(table) - 1.000001)
    row = place.astype(np.intp)
    low = table[row]
    low += (place - row)[:, None] * (table[row + 1] - low)
    return low
