"""Dryden gusts: turbulence of the wind along and across the motion through the air, which drag turns into force.

Eddies of the length L pass the vehicle at its airspeed, or, where it hovers, at the speed with which the gusts carry
each other: speed^2 = airspeed^2 + std^2.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from diagnosis.noise.component import AXES, Component, FlightConditions, Hyperparameter, Values, fixed_prior
from diagnosis.noise.linear_model import LinearModel, chain, compose, gauss_markov, gauss_markov_density
from dynamics.arrays import Floats

OUTPUTS = tuple(f"air_{axis}" for axis in AXES)


def passing_time(p: Values, c: FlightConditions) -> float:
    """Time in which an eddy passes, s."""
    return float(p["length"] / np.hypot(np.linalg.norm(c.air_velocity), p["std"]))


def directions(c: FlightConditions) -> Floats:
    """(3, 3) columns along the motion through the air, across it and level, across both; world axes in still air."""
    speed = np.linalg.norm(c.air_velocity)
    if speed == 0:
        return np.eye(3)
    along = c.air_velocity / speed
    across = np.cross([0.0, 0.0, 1.0], along)
    across = across / np.linalg.norm(across) if np.linalg.norm(across) > 0 else np.array([0.0, 1.0, 0.0])
    return np.stack([along, across, np.cross(along, across)], axis=1)


def model(p: Values, c: FlightConditions) -> LinearModel:
    """Shaping filters std sqrt(2 T) / (1 + T s) along, std sqrt(T) (1 + sqrt(3) T s) / (1 + T s)^2 across."""
    T = passing_time(p, c)
    F = np.array([[0.0, 1.0], [-1 / T**2, -2 / T]])
    H = np.array([1.0, np.sqrt(3) * T]) / T**2
    axes = [chain(axis, F, H, p["std"] * np.sqrt(T)) for axis in ("across", "upward")]
    gusts = compose([gauss_markov("along", p["std"], T), *axes])
    return replace(gusts, outputs=OUTPUTS, H=directions(c) @ gusts.H)


def spectrum(p: Values, c: FlightConditions, frequency: Floats) -> Mapping[str, Floats]:
    """2 std^2 T / (1 + (omega T)^2) along, std^2 T (1 + 3 (omega T)^2) / (1 + (omega T)^2)^2 across."""
    T = passing_time(p, c)
    squared = (2 * np.pi * frequency * T) ** 2
    across = p["std"] ** 2 * T * (1 + 3 * squared) / (1 + squared) ** 2
    density = directions(c) ** 2 @ np.stack([gauss_markov_density(p["std"], T, frequency), across, across])
    return dict(zip(OUTPUTS, density, strict=True))


COMPONENT = Component(
    name="dryden_gust",
    summary="Random wind: Dryden turbulence along and across the motion through the air",
    source="Dryden form, MIL-F-8785C, sec. 3.7.1.2; in hover Tennekes, J. Fluid Mech. 67, 1975 (eddies are swept past)",
    parameters=(
        Hyperparameter("std", "m/s", "standard deviation of each axis", 1e-3, 15.0, fixed_prior(0.5, 1.2)),
        Hyperparameter("length", "m", "length scale of the eddies", 0.05, 500.0, fixed_prior(2.0, 1.2)),
    ),
    model=model,
    spectrum=spectrum,
)
