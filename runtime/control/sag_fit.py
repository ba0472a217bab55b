"""How thrust follows the battery's voltage, from its effectiveness: the power of the voltage, by least squares.

Rotor speed goes with the voltage to the power of `gain` where it is not regulated, thrust with twice that power:
ln k = offset + 2 gain ln V. The effectiveness k has what else thrust lacks in the offset, and voltages of full
batteries do not matter. Shown where the voltage has fallen far enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from runtime.control.followed_parameters import FollowedParameter

BLOCK = 1.0  # s
EFFECTIVENESS_LAG = 1.3  # s, of the filter of the effectiveness, behind which the voltage is put, too
MIN_BLOCKS = 8
MODEL_ERROR = 0.003  # of ln k: what else changes while the battery empties


class SagFit:
    """Voltages and effectiveness in, the gain out. Pure: times are arguments.

    named: value and standard deviation by the parameter's name; its prior until a flight shows it.
    """

    def __init__(self, parameters: Sequence[FollowedParameter]) -> None:
        self.parameters = tuple(p for p in parameters if p.group == "voltage")[:1]
        self.named = {p.name: (p.value, p.std) for p in self.parameters}
        self._sums, self._pairs = np.zeros(6), (0.0, 0.0)  # of 1, x, y, x^2, x y, y^2 about the first block
        self._products, self._residual = np.zeros(2), 0.0
        self._block, self._began = np.zeros(3), math.nan
        self._voltage, self._last = math.nan, math.nan

    def add(self, time: float, voltage: float, effectiveness: float) -> None:
        """Take the battery's newest voltage, V, and the effectiveness of thrust. NaN voltages are none."""
        if not self.parameters or not (voltage > 0 and effectiveness > 0 and math.isfinite(voltage)):
            return
        if math.isnan(self._voltage):
            self._voltage, self._last, self._began = voltage, time, time
        share = 1 - math.exp(-max(time - self._last, 0.0) / EFFECTIVENESS_LAG)
        self._voltage += share * (voltage - self._voltage)
        self._last = time
        self._block += 1.0, math.log(self._voltage), math.log(effectiveness)
        if time - self._began >= BLOCK:
            self._take(*(self._block[1:] / self._block[0]).tolist())
            self._block[:], self._began = 0.0, time

    def _take(self, x: float, y: float) -> None:
        if not self._sums[0]:
            self._pairs = x, y
        x, y = x - self._pairs[0], y - self._pairs[1]
        self._sums += 1.0, x, y, x * x, x * y, y * y
        count, *moments = self._sums.tolist()
        if count < MIN_BLOCKS:
            return
        mean_x, mean_y, xx, xy, yy = (moment / count for moment in moments)
        spread, common = xx - mean_x**2, xy - mean_x * mean_y
        slope = common / max(spread, 1e-12)
        noise = max(yy - mean_y**2 - slope * common, 1e-8)
        residual = y - mean_y - slope * (x - mean_x)
        self._products += residual * self._residual, residual * residual
        self._residual = residual
        correlation = min(max(self._products[0] / self._products[1], math.exp(-BLOCK / EFFECTIVENESS_LAG)), 0.95)
        variance = noise * (1 + correlation) / (1 - correlation) / count + MODEL_ERROR**2
        (parameter,) = self.parameters
        information = 4 * spread / variance
        total = information + 1 / parameter.std**2
        value = (information * slope / 2 + parameter.value / parameter.std**2) / total
        bounded = float(min(max(value, parameter.lower), parameter.upper))
        self.named = {parameter.name: (bounded, float(total**-0.5))}
