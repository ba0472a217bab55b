"""The shifted solution: the previous solution, continued for a few ticks without a new one. Pure."""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Floats
from dynamics.state import RATE
from runtime.control.controller import Command, Controller


class ShiftedSolution:
    """The last good command and its prediction, and their continuation.

    controller: whose solution it is, None before the first.
    """

    def __init__(self) -> None:
        self.controller: Controller | None = None
        self._since = 0.0
        self._times = np.zeros(0)
        self._rates = np.zeros((0, 3))
        self._thrusts = np.zeros(0)
        self._rate = np.zeros(3)
        self._thrust = 0.0

    def keep(self, time: float, command: Command, controller: Controller) -> None:
        """Store a good solution of the tick at `time`, s; copies what the solver will overwrite."""
        self.controller = controller
        self._since, self._times = time, controller.node_times(time)
        self._rates = controller.predicted_states[:, RATE].copy()
        self._thrusts = controller.collective_thrust(controller.predicted_inputs)
        self._rate, self._thrust = command.rate_body, command.collective_thrust

    def reaches(self, time: float) -> bool:
        """Whether the prediction covers a time, s."""
        return self._times.size > 1 and self._since <= time < self._times[-2]

    def at(self, time: float) -> tuple[Floats, float]:
        """Rates (3,) rad/s and collective thrust, N, at a time: the last command plus the predicted change since."""
        rate = np.array([np.interp(time, self._times, self._rates[:, axis]) for axis in range(3)])
        thrust = float(np.interp(time, self._times[:-1], self._thrusts))
        return self._rate + rate - self._rates[0], self._thrust + thrust - float(self._thrusts[0])
