"""Gyro: white noise and a bias that walks, in each axis."""

from collections.abc import Mapping

import numpy as np

from diagnosis.noise.component import AXES, Component, FlightConditions, Hyperparameter, Values, fixed_prior
from diagnosis.noise.linear_model import LinearModel, compose, random_walk, white
from dynamics.arrays import Floats
from dynamics.effects.gyro_bias import SENSOR_PRIOR


def model(p: Values, _: FlightConditions, sensor: str = "gyro", bias: float = SENSOR_PRIOR) -> LinearModel:
    """reading = true + b + density w, db/dt = walk w'; the noises w are named x, y, z. bias: of a healthy sensor."""
    readings = [white(f"{sensor}_{axis}", p[f"density_{axis}"], noise=axis) for axis in AXES]
    return compose([*readings, *(random_walk(f"{sensor}_{axis}", p["walk"], bias) for axis in AXES)])


def spectrum(p: Values, _: FlightConditions, frequency: Floats, sensor: str = "gyro") -> Mapping[str, Floats]:
    """density^2 + walk^2 / omega^2."""
    slow = (p["walk"] / (2 * np.pi * frequency)) ** 2
    return {f"{sensor}_{axis}": p[f"density_{axis}"] ** 2 + slow for axis in AXES}


def densities(unit: str, meaning: str, lower: float, upper: float, median: float) -> tuple[Hyperparameter, ...]:
    """White noise of each axis: vibration has a direction."""
    prior = fixed_prior(median, 1.5)
    return tuple(Hyperparameter(f"density_{axis}", unit, f"{meaning} of {axis}", lower, upper, prior) for axis in AXES)


COMPONENT = Component(
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
