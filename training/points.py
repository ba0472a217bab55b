"""The points of the physics-inspired loss: histories, and what the textbook model says at their ends (eq. 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics.vehicle import Vehicle
from flights.labels import scaled_motors
from training.config import ModelConfig
from training.dataset import Dataset
from training.features import columns, outputs_from
from training.physics import textbook
from training.recipe import Recipe

Floats = NDArray[np.float64]
MOST_SCALING = 1.6  # of recorded velocity and rates in plausible histories


@dataclass(frozen=True, eq=False)
class Points:
    """windows: (p, T, inputs), oldest column first. targets: (p, 6) outputs of the textbook model at their ends."""

    windows: Floats
    targets: Floats


def physics_points(config: ModelConfig, recipe: Recipe, vehicle: Vehicle, data: Dataset, *, seed: int) -> Points:
    """The recipe's pool of points, drawn once before training."""
    random = np.random.default_rng([seed, 4])
    draw = _of_space if recipe.physics_points == "space" else _plausible
    states, speeds = draw(config, recipe.physics_pool, vehicle, data, random)
    last = textbook(vehicle, dt=config.dt, label=config.label)(states[-1], speeds[-1])
    moving = np.swapaxes(states[:, :, 3:], 0, 1)
    windows = columns(config, moving, scaled_motors(np.swapaxes(speeds, 0, 1)))
    return Points(windows, outputs_from(config, vehicle, last.body, None, states[-1][:, 6:10]))


def _of_space(
    config: ModelConfig, count: int, vehicle: Vehicle, data: Dataset, random: np.random.Generator
) -> tuple[Floats, Floats]:
    """States (T, count, 13) and rotor speeds (T, count, rotors) that end anywhere in the state-input space.

    Velocity: each axis up to the highest recorded speed. Rates: up to the vehicle's limits. Attitude: any. Rotors: any
    speed, held. The past follows from the textbook model run backwards, so that columns are consistent.
    """
    fastest = float(np.linalg.norm(data.state[data.ends, :3], axis=1).max())
    rate = np.array(vehicle.limits.rate)
    attitude = random.normal(size=(count, 4))
    attitude *= np.where(attitude[:, :1] < 0, -1, 1) / np.linalg.norm(attitude, axis=1, keepdims=True)
    velocity = random.uniform(-fastest, fastest, (count, 3))
    state = np.hstack([np.zeros((count, 3)), velocity, attitude, random.uniform(-rate, rate, (count, 3))])
    speed = random.uniform(vehicle.rotors.speed_min, vehicle.rotors.speed_max, (count, vehicle.rotors.count))
    back = textbook(vehicle, dt=-config.dt, label="instantaneous")
    states = [state]
    for _ in range(config.history - 1):
        states.append(back(states[-1], speed).following)
    return np.stack(states[::-1]), np.stack([speed] * config.history)


def _plausible(
    config: ModelConfig, count: int, vehicle: Vehicle, data: Dataset, random: np.random.Generator
) -> tuple[Floats, Floats]:
    """The same from recorded motion: velocity and rates times 1 to 1.6, then the recorded motors on the textbook model.

    Faster than what was flown, but never far from it.
    """
    first = random.choice(data.ends, count) - (config.history - 1)
    state = np.hstack([data.position[first], data.state[first]])
    faster = random.uniform(1.0, MOST_SCALING, (count, 1))
    state[:, 3:6] *= faster
    state[:, 10:13] *= faster
    forward = textbook(vehicle, dt=config.dt, label=config.label)
    driven = [data.motors[first + step] / scaled_motors(np.ones(1)) for step in range(config.history)]
    states = [state]
    for speed in driven[:-1]:
        states.append(forward(states[-1], speed).following)
    return np.stack(states), np.stack(driven)
