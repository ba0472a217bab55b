"""Motion capture: white noise of each reading of the pose, at the rate of the system."""

from collections.abc import Mapping

import numpy as np

from diagnosis.noise.component import AXES, Component, FlightConditions, Hyperparameter, Values, fixed_prior
from diagnosis.noise.linear_model import LinearModel, compose, read_noise
from dynamics.arrays import Floats


def variances(p: Values, c: FlightConditions) -> dict[str, float]:
    """Variance of a row of each output: a row is the mean of its readings, rows without one are missing."""
    readings = max(1.0, c.pose_rate * c.period)
    return {f"{kind}_{axis}": p[kind] ** 2 / readings for kind in ("position", "attitude") for axis in AXES}


def model(p: Values, c: FlightConditions) -> LinearModel:
    """reading = true + std r with independent r."""
    return compose([read_noise(output, variance) for output, variance in variances(p, c).items()])


def spectrum(p: Values, c: FlightConditions, frequency: Floats) -> Mapping[str, Floats]:
    """Variance times period, of a white sequence of rows."""
    return {output: np.full(len(frequency), variance * c.period) for output, variance in variances(p, c).items()}


COMPONENT = Component(
    name="motion_capture",
    summary="White noise of position and attitude from motion capture",
    source="independent noise of readings, Maybeck, Stochastic Models, Estimation, and Control, vol. 1, 1979",
    parameters=(
        Hyperparameter("position", "m", "standard deviation of a reading", 1e-6, 0.1, fixed_prior(5e-4, 1.2)),
        Hyperparameter("attitude", "rad", "standard deviation of a reading", 1e-6, 0.2, fixed_prior(2e-3, 1.2)),
    ),
    model=model,
    spectrum=spectrum,
)
