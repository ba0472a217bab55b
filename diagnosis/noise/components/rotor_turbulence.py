"""Rotor turbulence: each rotor's thrust fluctuates by a share of itself, independently of the others."""

from collections.abc import Mapping

import numpy as np

from diagnosis.noise.component import Component, FlightConditions, Hyperparameter, Values, fixed_prior
from diagnosis.noise.linear_model import LinearModel, gauss_markov_density
from dynamics.arrays import Floats

OUTPUTS = ("force_z", "torque_x", "torque_y", "torque_z")


def wrench(c: FlightConditions) -> Floats:
    """(4, n) force along body z and torques of one part of each rotor's thrust (PI-TCN eq. 2)."""
    rotors, (x, y, _) = c.vehicle.rotors, c.vehicle.body.centre_of_mass
    per_thrust = rotors.allocation / rotors.thrust_constant
    per_thrust[1] -= y
    per_thrust[2] += x
    return np.asarray(per_thrust * c.rotor_thrust)


def model(p: Values, c: FlightConditions) -> LinearModel:
    """dx_i/dt = -x_i / time + share sqrt(2 / time) w_i; the thrust of rotor i is (1 + x_i) times the model's."""
    n = len(c.rotor_thrust)
    names, Qc = tuple(f"rotor_{place}" for place in range(n)), np.full(n, 2 * p["share"] ** 2 / p["time"])
    return LinearModel(names, names, OUTPUTS, -np.eye(n) / p["time"], np.eye(n), wrench(c), Qc)


def spectrum(p: Values, c: FlightConditions, frequency: Floats) -> Mapping[str, Floats]:
    """Sum over rotors of wrench_i^2 2 share^2 time / (1 + (omega time)^2)."""
    shape = gauss_markov_density(p["share"], p["time"], frequency)
    return dict(zip(OUTPUTS, (wrench(c) ** 2).sum(1)[:, None] * shape, strict=True))


COMPONENT = Component(
    name="rotor_turbulence",
    summary="Fluctuation of each rotor's thrust",
    source="Uhlenbeck and Ornstein, Phys. Rev. 36, 1930, through the rotors' places",
    parameters=(
        Hyperparameter(
            "share", "1", "standard deviation of a rotor's thrust over itself", 1e-5, 1, fixed_prior(0.01, 1.2)
        ),
        Hyperparameter("time", "s", "correlation time", 0.005, 3.0, fixed_prior(0.05, 1.0)),
    ),
    model=model,
    spectrum=spectrum,
)
