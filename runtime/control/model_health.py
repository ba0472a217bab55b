"""Health of a learned model in flight: its inputs against their range in training, and its running prediction error.

Pure: time is an argument, s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.network_inputs import Frame, state_inputs
from dynamics.state import RATE, VELOCITY
from runtime.control.bundle import Bundle
from runtime.running_mean import RunningMean


class FitLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits beyond which a learned model does not fit the flight.

    ratio: of the running error to that in training, above which the model does not fit.
    averaging: time constant of the running error, s.
    margin: distance outside of its range in training up to which an input is accepted, as a share of that range.
    linear_resolution: m/s^2, error that estimates at 100 Hz cannot resolve; added in quadrature to that of training.
    angular_resolution: rad/s^2, the same of angular accelerations.
    """

    ratio: float = 5.0
    averaging: float = 0.5
    margin: float = 0.1
    linear_resolution: float = msgspec.field(default=0.5, name="least_linear")
    angular_resolution: float = msgspec.field(default=2.0, name="least_angular")


@dataclass(frozen=True, eq=False)
class TrainingRange:
    """Smallest and largest inputs (k,) in training, in SI units, and their names; empty for a model without ranges."""

    frame: Frame
    names: tuple[str, ...]
    lowest: Floats
    highest: Floats

    @classmethod
    def from_bundle(cls, bundle: Bundle) -> TrainingRange:
        """The ranges in a bundle's manifest."""
        low, high = bundle.range_limits
        return cls(bundle.manifest.frame, tuple(r.name for r in bundle.manifest.ranges), low, high)

    def outside(self, state: Floats, speed: Floats, margin: float) -> str:
        """Which input of a state (13,) and rotor speeds (n,) lies outside, empty when none does."""
        if not self.names:
            return ""
        inputs = np.concatenate([state_inputs(self.frame, state), speed])
        room = margin * (self.highest - self.lowest)
        excess = np.maximum(self.lowest - room - inputs, inputs - self.highest - room)
        worst = int(np.argmax(excess))
        if not excess[worst] > 0:
            return ""
        low, high = self.lowest[worst], self.highest[worst]
        return f"{self.names[worst]} is {inputs[worst]:.3g}, trained on {low:.3g} to {high:.3g}"


class ModelHealth:
    """The running ratio of a model's error in flight to its error in training.

    Errors are averaged as vectors, so that the estimates' noise cancels and the model's error remains.
    """

    def __init__(self, linear: float, angular: float, limits: FitLimits) -> None:
        """linear, angular: RMSE of training, m/s^2 and rad/s^2."""
        self._scale = np.array(
            [math.hypot(linear, limits.linear_resolution)] * 3 + [math.hypot(angular, limits.angular_resolution)] * 3
        )
        self._averaging = limits.averaging
        self.reset()

    def compare(self, predicted: Floats, measured: Floats, elapsed: float) -> None:
        """Compare a prediction (13,) over `elapsed` s with the measurement (13,)."""
        if elapsed < 1e-3:
            return
        change = measured - predicted
        error = np.concatenate([change[VELOCITY], change[RATE]]) / elapsed
        self._mean.add(error / self._scale, elapsed)

    @property
    def ratio(self) -> float:
        """Running error over the error in training; 1 where the model fits as well as there."""
        return float(np.sqrt(np.mean(self._mean.value**2)))

    def reset(self) -> None:
        """Restart the average."""
        self._mean = RunningMean(self._averaging, np.zeros(6))
