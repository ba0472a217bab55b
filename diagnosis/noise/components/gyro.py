"""Gyro: white noise and a bias that walks, in each axis."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from diagnosis.noise.component import AXES, Component, FlightConditions, Hyperparameter, Values, fixed_prior
from diagnosis.noise.linear_model import LinearModel, compose, random_walk, white
from dynamics.arrays import Floats
from dynamics.effects.gyro_bias import SENSOR_PRIOR


def model(p: Values, _: FlightConditions, sensor: str = "gyro", bias: float = SENSOR_PRIOR) -> LinearModel:
    """reading = true + b + x, filter_time dx/dt = density w - x, db/dt = walk w'; the noises w are named x, y, z.

    bias: of a healthy sensor. Without a filter_time the noise is white.
    """
    readings = [white(f"{sensor}_{axis}", p[f"density_{axis}"], noise=axis) for axis in AXES]
    if "filter_time" in p:
        filters = {axis: np.array([[1 / p["filter_time"]]]) for axis in AXES}
        readings = [
            LinearModel((f"filtered_{axis}",), (axis,), (f"{sensor}_{axis}",), -rate, rate, np.ones((1, 1)),
                        np.array([p[f"density_{axis}"] ** 2]))
            for axis, rate in filters.items()
        ]  # fmt: skip
    return compose([*readings, *(random_walk(f"{sensor}_{axis}", p["walk"], bias) for axis in AXES)])


def spectrum(p: Values, _: FlightConditions, frequency: Floats, sensor: str = "gyro") -> Mapping[str, Floats]:
    """density^2 / (1 + (omega filter_time)^2) + walk^2 / omega^2."""
    omega = 2 * np.pi * frequency
    passed, slow = 1 / (1 + (omega * p.get("filter_time", 0.0)) ** 2), (p["walk"] / omega) ** 2
    return {f"{sensor}_{axis}": p[f"density_{axis}"] ** 2 * passed + slow for axis in AXES}


def densities(unit: str, meaning: str, lower: float, upper: float, median: float) -> tuple[Hyperparameter, ...]:
    """White noise of each axis: vibration has a direction."""
    prior = fixed_prior(median, 1.5)
    return tuple(Hyperparameter(f"density_{axis}", unit, f"{meaning} of {axis}", lower, upper, prior) for axis in AXES)


WHITE = Component(
    name="gyro",
    summary="White noise and bias random walk of the body rate's reading",
    source="angular random walk and rate random walk, IEEE Std 952-1997, annex C",
    parameters=(
        *densities("rad/sqrt(s)", "angular random walk", 1e-6, 1.0, 1e-3),
        Hyperparameter("walk", "rad/s^1.5", "rate random walk, of the bias", 1e-8, 0.1, fixed_prior(1e-4, 1.5)),
    ),
    model=model,
    spectrum=spectrum,
)
COMPONENT = replace(
    WHITE,
    summary="Low-passed white noise and bias random walk of the body rate's reading",
    parameters=(
        *WHITE.parameters,
        Hyperparameter("filter_time", "s", "time constant of its low-pass", 2e-4, 0.03, fixed_prior(2e-3, 0.7)),
    ),
)
