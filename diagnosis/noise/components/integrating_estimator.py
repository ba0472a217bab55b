"""Estimator that integrates the logged gyro and accelerometer: the sensors' noise is its pose's noise as well.

Its pose errs by the integral of the very noise that is in the logged readings, and is drawn back slowly by its other
sensors, whose noise the error takes on. Errors are in body axes and linear; biases are taken as estimated.
"""

from collections.abc import Mapping

import numpy as np

from diagnosis.noise.component import AXES, Component, FlightConditions, Values
from diagnosis.noise.components.smooth_estimator import KINDS, hyperparameters
from diagnosis.noise.linear_model import LinearModel
from dynamics.arrays import Floats
from dynamics.rotation_matrix import skew

SENSORS = ("gyro", "accelerometer")
OUTPUTS = tuple(f"{kind}_{axis}" for kind in KINDS for axis in AXES)


def model(p: Values, c: FlightConditions) -> LinearModel:
    """Error of attitude a, velocity v, position s about specific force f and body rate w (Titterton, ch. 12).

    da/dt = -w x a - a / time + n_gyro + aiding, dv/dt = -w x v - f x a - v / time + n_accelerometer + aiding,
    ds/dt = -w x s + v - s / time + aiding; aiding of the intensity 2 std^2 / time.
    """
    own = tuple(f"aiding_{output}" for output in OUTPUTS)
    shared = tuple(f"{sensor}.{axis}" for sensor in SENSORS for axis in AXES)
    F = np.zeros((9, 9))
    for place, kind in enumerate(KINDS):
        rows = slice(3 * place, 3 * place + 3)
        F[rows, rows] = -skew(c.rate_body) - np.eye(3) / p[f"{kind}_time"]
    F[3:6, 0:3], F[6:9, 3:6] = -skew(c.specific_force), np.eye(3)
    L = np.hstack([np.eye(9), np.eye(9)[:, :6]])
    aiding = [2 * p[f"{kind}_std"] ** 2 / p[f"{kind}_time"] for kind in KINDS for _ in AXES]
    return LinearModel(OUTPUTS, own + shared, OUTPUTS, F, L, np.eye(9), np.array([*aiding, *[np.nan] * 6]))


def spectrum(p: Values, c: FlightConditions, frequency: Floats) -> Mapping[str, Floats]:
    """(aiding + the sensor's density^2 + density of what it integrates) / (omega^2 + 1 / time^2)."""
    sensors = {kind: np.zeros((3, 1)) for kind in KINDS}
    for kind, sensor in zip(KINDS, SENSORS, strict=False):
        sensors[kind] = np.array([[p[f"{sensor}.density_{axis}"]] for axis in AXES])
    integrated, result = np.zeros((3, 1)), dict[str, Floats]()
    for kind, turn in zip(KINDS, (skew(c.specific_force) ** 2, np.eye(3), np.eye(3)), strict=True):
        rate = 1 / p[f"{kind}_time"]
        inputs = 2 * p[f"{kind}_std"] ** 2 * rate + sensors[kind] ** 2 + integrated
        density = inputs / ((2 * np.pi * frequency) ** 2 + rate**2)
        integrated = turn @ density
        result |= {f"{kind}_{axis}": row for axis, row in zip(AXES, density, strict=True)}
    return result


COMPONENT = Component(
    name="integrating_estimator",
    summary="Pose of an estimator that integrates the logged gyro and accelerometer",
    source="Titterton and Weston, Strapdown Inertial Navigation Technology, 2004, ch. 12 (error equations)",
    parameters=(
        *hyperparameters("attitude", "rad", 0.015, 3.0),
        *hyperparameters("velocity", "m/s", 0.15, 2.0),
        *hyperparameters("position", "m", 0.3, 2.0),
    ),
    model=model,
    spectrum=spectrum,
    needs=SENSORS,
)
