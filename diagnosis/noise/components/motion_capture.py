"""Motion capture: white noise of each reading of the pose, at the rate of the system."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from diagnosis.noise.component import AXES, Component, FlightConditions, Hyperparameter, Values, fixed_prior
from diagnosis.noise.linear_model import LinearModel, compose, read_noise
from dynamics.arrays import Floats


def variances(p: Values, c: FlightConditions, kinds: tuple[str, ...]) -> dict[str, float]:
    """Variance of a row of each output: a row is the mean of its readings, rows without one are missing."""
    readings = max(1.0, c.pose_rate * c.period)
    return {f"{kind}_{axis}": p[kind] ** 2 / readings for kind in kinds for axis in AXES}


def model(p: Values, c: FlightConditions, kinds: tuple[str, ...]) -> LinearModel:
    """reading = true + std r with independent r."""
    return compose([read_noise(output, variance) for output, variance in variances(p, c, kinds).items()])


def spectrum(p: Values, c: FlightConditions, frequency: Floats, kinds: tuple[str, ...]) -> Mapping[str, Floats]:
    """Variance times period, of a white sequence of rows."""
    densities = variances(p, c, kinds)
    return {output: np.full(len(frequency), variance * c.period) for output, variance in densities.items()}


def component(name: str, summary: str, parameters: tuple[Hyperparameter, ...]) -> Component:
    """White noise of the kinds of readings that the parameters are named after."""
    kinds = tuple(parameter.name for parameter in parameters)
    return Component(
        name=name,
        summary=summary,
        source="independent noise of readings, Maybeck, Stochastic Models, Estimation, and Control, vol. 1, 1979",
        parameters=parameters,
        model=partial(model, kinds=kinds),
        spectrum=partial(spectrum, kinds=kinds),
    )


COMPONENT = component(
    "motion_capture",
    "White noise of position and attitude from motion capture",
    (
        Hyperparameter("position", "m", "standard deviation of a reading", 1e-6, 0.1, fixed_prior(5e-4, 1.2)),
        Hyperparameter("attitude", "rad", "standard deviation of a reading", 1e-6, 0.2, fixed_prior(2e-3, 1.2)),
    ),
)
