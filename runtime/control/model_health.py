"""A learned model in flight: what it was trained on, and how well it still fits. Pure: time is an argument, s."""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from runtime.control.bundle import Bundle
from runtime.running_mean import RunningMean

DOWN = np.array([0.0, 0.0, -1.0])


class FitLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """ratio: of the running error to training's, from which on the model does not fit. averaging: s of it.

    margin: share of a range by which inputs may lie outside of it; networks bear a little. least_linear m/s^2,
    least_angular rad/s^2: what estimates at 100 Hz cannot resolve, added to training's errors.
    """

    ratio: float = 5.0
    averaging: float = 0.5
    margin: float = 0.1
    least_linear: float = 0.5
    least_angular: float = 2.0


@dataclass(frozen=True, eq=False)
class TrainingRange:
    """Least and greatest inputs (k,) in training, in SI units, and their names; empty for a model without any."""

    frame: str
    names: tuple[str, ...]
    lowest: Floats
    highest: Floats

    @classmethod
    def of(cls, bundle: Bundle) -> TrainingRange:
        """The range that a bundle's manifest tells."""
        low, high = bundle.range_limits
        return cls(bundle.manifest.frame, tuple(r.name for r in bundle.manifest.ranges), low, high)

    def outside(self, state: Floats, speed: Floats, margin: float) -> str:
        """Which input of a state (13,) and rotor speeds (n,) lies outside, empty when none does."""
        if not self.names:
            return ""
        velocity, attitude = state[3:6], state[6:10]
        if self.frame == "body":
            velocity, attitude = (quaternion.rotate_inverse(state[6:10], vector) for vector in (velocity, DOWN))
        inputs = np.concatenate([velocity, attitude, state[10:13], speed])
        room = margin * (self.highest - self.lowest)
        excess = np.maximum(self.lowest - room - inputs, inputs - self.highest - room)
        worst = int(np.argmax(excess))
        if not excess[worst] > 0:
            return ""
        low, high = self.lowest[worst], self.highest[worst]
        return f"{self.names[worst]} is {inputs[worst]:.3g}, trained on {low:.3g} to {high:.3g}"


class ModelHealth:
    """The running ratio of a model's error in flight to its error in training.

    Errors are averaged as vectors, so that the estimates' noise cancels and what the model misses remains.
    """

    def __init__(self, linear: float, angular: float, limits: FitLimits) -> None:
        """linear, angular: RMSE of training, m/s^2 and rad/s^2."""
        self._scale = np.array(
            [math.hypot(linear, limits.least_linear)] * 3 + [math.hypot(angular, limits.least_angular)] * 3
        )
        self._averaging = limits.averaging
        self.reset()

    def compare(self, predicted: Floats, measured: Floats, elapsed: float) -> None:
        """A prediction (13,) over `elapsed` s against what was then measured (13,)."""
        if elapsed < 1e-3:
            return
        miss = np.concatenate([measured[3:6] - predicted[3:6], measured[10:13] - predicted[10:13]]) / elapsed
        self._mean.add(miss / self._scale, elapsed)

    @property
    def ratio(self) -> float:
        """Error over training's error, 1 where the model fits as it did."""
        return float(np.sqrt(np.mean(self._mean.value**2)))

    def reset(self) -> None:
        """Begin anew."""
        self._mean = RunningMean(self._averaging, np.zeros(6))
