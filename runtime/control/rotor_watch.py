"""Compares what the rotors did with how the vehicle moved: rotors that lose thrust in flight."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from dynamics.arrays import Floats
from runtime.control.flight_filter import MAX_INTERVAL
from runtime.control.moment_fit import MomentFit
from runtime.control.readings import Readings
from runtime.control.rotor_loss import RotorLoss, RotorLossSettings, RotorLossTest
from runtime.control.rotor_speeds import RotorSpeeds
from runtime.control.rti.solver import RtiSolver

WAITING = 32  # estimates that wait for the rotor speeds of their time


class RotorWatch:
    """Rotor speeds and estimates in, rotors that have lost thrust out. Pure: times are arguments."""

    def __init__(self, solver: RtiSolver, settings: RotorLossSettings, moments: MomentFit, *, motor_lag: float) -> None:
        """solver: of a model that is none of a network. motor_lag: s, of the motors behind the autopilot's outputs.

        moments: which show in the same comparison.
        """
        self._moments = moments
        self.speeds = RotorSpeeds(lag=motor_lag)
        self._force = Readings()
        self._solver, self._settings = solver, settings
        self._test = RotorLossTest(solver.inputs.shape[1], settings)
        self._sums_at: int = self._test.sums.ctypes.data
        self._waiting: deque[tuple[float, Floats]] = deque(maxlen=WAITING)

    @property
    def losses(self) -> tuple[RotorLoss, ...]:
        """Of the rotors that have been named so far."""
        return tuple(self._test.losses.values())

    @property
    def grave(self) -> bool:
        """Whether a loss is beyond the limit."""
        return any(loss.share > self._settings.limit for loss in self._test.losses.values())

    def clear(self) -> None:
        """Forget all but the losses."""
        self.speeds.clear()
        self._force.clear()
        self._test.clear()
        self._waiting.clear()

    def read(self, time: float, speed: Floats, *, measured: bool) -> None:
        """Take a reading of all rotors (n,), rad/s: of their ESCs, or as the autopilot's outputs command them."""
        if self.speeds.add(time, speed.tolist(), measured=measured):
            self._test.clear()  # of another kind: a difference between both is no step

    def read_force(self, time: float, specific_force: float) -> None:
        """Take a specific force along body z, m/s^2, as it arrived; NaN is none."""
        self._force.add(time, (specific_force,))

    def add_estimate(self, time: float, state: Floats) -> None:
        """Take an estimate with the model's hidden states (nx,)."""
        if not self._waiting or time > self._waiting[-1][0]:
            self._waiting.append((time, state))

    def update(self) -> None:
        """Compare those estimates whose rotor speeds have arrived."""
        while len(self._waiting) > 1 and self._waiting[1][0] <= self.speeds.newest:
            start, before = self._waiting.popleft()
            stop, state = self._waiting[0]
            speeds = self.speeds.mean(start, stop) if stop - start <= MAX_INTERVAL else None
            if speeds is not None:
                self._compare(before, speeds, state, start, stop)

    def _compare(self, before: Floats, speeds: Sequence[float], state: Floats, start: float, stop: float) -> None:
        seconds = stop - start
        force = self._force.mean(start, stop)
        measured = math.nan if force is None else force[0]
        beyond, shares = self._solver.add_rotor_shares(before, speeds, state, seconds, measured, self._sums_at)
        self._test.advance(seconds)
        if self._moments.parameters:
            self._moments.add(before, np.array(speeds), state, beyond.copy(), shares.copy(), seconds)
