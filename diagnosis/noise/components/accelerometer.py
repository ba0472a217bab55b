"""Accelerometer: white noise and a bias that walks, in each axis."""

from functools import partial

from diagnosis.noise.component import Component, Hyperparameter, fixed_prior
from diagnosis.noise.components import gyro
from dynamics.effects.imu_bias import SENSOR_PRIOR

COMPONENT = Component(
    name="accelerometer",
    summary="White noise and bias random walk of the specific force's reading",
    source="as of the gyro, IEEE Std 952-1997, annex C",
    parameters=(
        *gyro.densities("m/s^1.5", "velocity random walk", 1e-5, 10.0, 1e-2),
        Hyperparameter("walk", "m/s^2.5", "acceleration random walk, of the bias", 1e-7, 1.0, fixed_prior(1e-3, 1.5)),
    ),
    model=partial(gyro.model, sensor="accelerometer", bias=SENSOR_PRIOR),
    spectrum=partial(gyro.spectrum, sensor="accelerometer"),
)
