"""Collocation points of the physics-inspired loss (PI-TCN eq. 4): histories, and a physical model's output at the ends.

Anywhere in the space, or on plausible histories, this is the nominal model's accelerations. For a pulse on the rotors
it is the change of the vehicle file's model by the pulse; for a residual on all named effects this change is zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, RATE, VELOCITY
from dynamics.vehicle import Vehicle
from training.config import ModelConfig
from training.data.features import columns, outputs_from
from training.data.labelled_rows import LabelledRows
from training.physics import BatchModel, nominal_model
from training.recipe import Recipe

PULSE_DEVIATION = 60.0  # rad/s, standard deviation of the pulses on rotor speeds; each lasts one column or more
SINGLE_ROTOR_SHARE = 0.5  # share of pulses that are on one rotor alone
MAX_SCALING = 1.6  # of recorded velocity and rates in plausible histories


@dataclass(frozen=True, eq=False)
class CollocationPoints:
    """Points at which a network is compared with a physical model.

    windows: (p, T, inputs), oldest column first.
    targets: (p, 6) correct outputs for them.
    unperturbed: (p, T, inputs) the windows without a pulse; targets are then the correct change of the output.
    """

    windows: Floats
    targets: Floats
    unperturbed: Floats | None = None


def collocation_points(
    config: ModelConfig, recipe: Recipe, vehicle: Vehicle, data: LabelledRows, *, seed: int
) -> CollocationPoints:
    """The recipe's pool of points, drawn once before training."""
    random = np.random.default_rng([seed, 4])
    if recipe.physics_points == "pulses":
        return _pulsed(config, recipe.physics_pool, vehicle, data, random)
    draw = _of_space if recipe.physics_points == "space" else _plausible
    states, speeds = draw(config, recipe.physics_pool, vehicle, data, random)
    last = nominal_model(vehicle, dt=config.dt, label=config.label)(states[-1], speeds[-1])
    windows = columns(config, np.swapaxes(states, 0, 1), np.swapaxes(speeds, 0, 1))
    return CollocationPoints(windows, outputs_from(config, vehicle, last.body, None, states[-1][:, ATTITUDE]))


def _of_space(
    config: ModelConfig, count: int, vehicle: Vehicle, data: LabelledRows, random: np.random.Generator
) -> tuple[Floats, Floats]:
    """States (T, count, 13) and rotor speeds (T, count, rotors) that end anywhere in the state-input space.

    Velocity: each axis up to the highest recorded speed. Rates: up to the vehicle's limits. Attitude: any. Rotors: any
    speed, held. The past follows from the nominal model run backwards, so that columns are consistent.
    """
    fastest = float(np.linalg.norm(data.state[data.ends, VELOCITY], axis=1).max())
    rate = np.array(vehicle.limits.rate)
    attitude = random.normal(size=(count, 4))
    attitude *= np.where(attitude[:, :1] < 0, -1, 1) / np.linalg.norm(attitude, axis=1, keepdims=True)
    velocity = random.uniform(-fastest, fastest, (count, 3))
    state = np.hstack([np.zeros((count, 3)), velocity, attitude, random.uniform(-rate, rate, (count, 3))])
    speed = random.uniform(vehicle.rotors.speed_min, vehicle.rotors.speed_max, (count, vehicle.rotors.count))
    back = nominal_model(vehicle, dt=-config.dt, label="instantaneous")
    states = [state]
    for _ in range(config.history - 1):
        states.append(back(states[-1], speed).following)
    return np.stack(states[::-1]), np.stack([speed] * config.history)


def _pulsed(
    config: ModelConfig, count: int, vehicle: Vehicle, data: LabelledRows, random: np.random.Generator
) -> CollocationPoints:
    """Recorded histories with and without a pulse on the rotors and the vehicle file's model's response to it.

    All other forces, mainly of the air, are those of the recording.
    """
    ends = random.choice(data.ends, count)
    rows = ends[:, None] + np.arange(1 - config.history, 1)
    recorded, speed = data.state[rows], data.rotor_speed[rows]
    size = random.normal(0, PULSE_DEVIATION, (count, vehicle.rotors.count))
    alone = np.eye(vehicle.rotors.count)[random.integers(vehicle.rotors.count, size=count)]
    size = np.where(random.random((count, 1)) < SINGLE_ROTOR_SHARE, size * alone, size)
    begin = random.integers(0, config.history, (count, 1))
    until = begin + random.integers(1, max(config.history, 2), (count, 1))
    column = np.arange(config.history)
    during = (begin <= column) & (column < until)
    pulsed = np.clip(speed + during[:, :, None] * size[:, None], vehicle.rotors.speed_min, vehicle.rotors.speed_max)
    first = recorded[:, 0]
    (plain, plain_body), (moved, moved_body) = (_driven(config, vehicle, first, driven) for driven in (speed, pulsed))
    state = recorded + moved - plain
    turned = quaternion.multiply(quaternion.conjugate(plain[..., ATTITUDE]), moved[..., ATTITUDE])
    state[..., ATTITUDE] = quaternion.multiply(recorded[..., ATTITUDE], turned)
    outputs = [
        outputs_from(config, vehicle, body, _base(config, vehicle, body, last, driven[:, -1]), last[:, ATTITUDE])
        for body, last, driven in ((moved_body, moved[:, -1], pulsed), (plain_body, plain[:, -1], speed))
    ]
    windows = columns(config, state, pulsed)
    return CollocationPoints(windows, outputs[0] - outputs[1], columns(config, recorded, speed))


def _driven(config: ModelConfig, vehicle: Vehicle, first: Floats, speed: Floats) -> tuple[Floats, Floats]:
    """(m, T, 13) states of the vehicle file's model from first (m, 13) on; its body accelerations (m, 6) at the last.

    speed: (m, T, rotors) rad/s.
    """
    model = BatchModel(vehicle, vehicle.effects, speed[:, 0], dt=config.dt, label=config.label, motors=config.motors)
    states, body = [first], np.empty((len(first), 6))
    for step in range(config.history):
        rows = model(states[-1], speed[:, step])
        states.append(rows.following)
        body = rows.body
    return np.stack(states[:-1], axis=1), body


def _base(config: ModelConfig, vehicle: Vehicle, body: Floats, state: Floats, speed: Floats) -> Floats | None:
    """The base that a network's outputs are added to: none, the nominal model, or the vehicle file's model."""
    if config.base == "nominal":
        return nominal_model(vehicle, dt=config.dt, label=config.label)(state, speed).body
    return None if config.base == "none" else body


def _plausible(
    config: ModelConfig, count: int, vehicle: Vehicle, data: LabelledRows, random: np.random.Generator
) -> tuple[Floats, Floats]:
    """States (T, count, 13) and rotor speeds (T, count, rotors) near the recorded motion, but faster.

    Recorded velocity and rates times 1 to 1.6, then the nominal model under recorded rotor speeds.
    """
    first = random.choice(data.ends, count) - (config.history - 1)
    state = data.state[first]
    faster = random.uniform(1.0, MAX_SCALING, (count, 1))
    state[:, VELOCITY] *= faster
    state[:, RATE] *= faster
    forward = nominal_model(vehicle, dt=config.dt, label=config.label)
    driven = [data.rotor_speed[first + step] for step in range(config.history)]
    states = [state]
    for speed in driven[:-1]:
        states.append(forward(states[-1], speed).following)
    return np.stack(states), np.stack(driven)
