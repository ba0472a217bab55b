"""Rotor motion: speeds that are measured, and change by what the log does not tell in advance.

The model's input is then what readings before a row predict of the speeds, not the reading of the row itself, which
holds its own error and, through the controller, the vehicle's answer to the disturbance of the row.
"""

from collections.abc import Mapping

import numpy as np

from diagnosis.noise.component import Component, FlightConditions, Hyperparameter, Values, fixed_prior
from diagnosis.noise.linear_model import LinearModel
from dynamics.arrays import Floats


def model(p: Values, c: FlightConditions) -> LinearModel:
    """dOmega/dt = s, ds/dt = drive w; reading = Omega + reading r. States: all speeds, then all slopes."""
    n = len(c.rotor_thrust)
    rotors = range(n)
    states = (*(f"speed_{i}" for i in rotors), *(f"slope_{i}" for i in rotors))
    outputs = (*(f"rotor_speed_{i}" for i in rotors), *(f"speed_reading_{i}" for i in rotors))
    F, L, H = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n)), np.zeros((2 * n, 2 * n))
    F[:n, n:] = L[n:] = H[:n, :n] = np.eye(n)
    R = np.concatenate([np.zeros(n), np.full(n, p["reading"] ** 2)])
    start = np.concatenate([np.full(n, p["reading"]), np.full(n, p["drive"])])
    return LinearModel(states, tuple(f"drive_{i}" for i in rotors), outputs, F, L, H, np.full(n, p["drive"] ** 2), R=R,
                       start_std=start)  # fmt: skip


def spectrum(p: Values, c: FlightConditions, frequency: Floats) -> Mapping[str, Floats]:
    """drive^2 / omega^4 of the speeds; the reading's variance times the period."""
    moving = p["drive"] ** 2 / (2 * np.pi * frequency) ** 4
    reading = np.full(len(frequency), p["reading"] ** 2 * c.period)
    rotors = range(len(c.rotor_thrust))
    return {f"rotor_speed_{i}": moving for i in rotors} | {f"speed_reading_{i}": reading for i in rotors}


COMPONENT = Component(
    name="rotor_motion",
    summary="Measured rotor speeds and how they change from row to row",
    source="local linear trend, Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, ch. 2",
    parameters=(
        Hyperparameter("drive", "rad/s^2.5", "random walk of the acceleration", 1e-1, 1e7, fixed_prior(5e3, 2.0)),
        Hyperparameter("reading", "rad/s", "standard deviation of a reading", 1e-4, 300.0, fixed_prior(2.0, 2.0)),
    ),
    model=model,
    spectrum=spectrum,
)
