"""Trains the networks that `network.py` flies: on a quadrotor with motor lag and drag, flown geometrically.

The plant takes rotor speeds directly, at 100 Hz, as the closed loop of the benchmark does; random references and dither
on the commands excite it. Run by the benchmark, in a process of its own:

    python -m benchmarks.kernel.network_worker pi_tcn FILE.pt [--steps 6000]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from torch import nn

from dynamics import quaternion
from dynamics.codegen import compile_functions
from dynamics.integrators import step_function
from dynamics.model import ENVIRONMENT_DEFAULT, Model, build_model
from dynamics.state import ATTITUDE, RATE, VELOCITY
from dynamics.units import RPM
from dynamics.vehicle import GRAVITY, EffectUse, Vehicle
from dynamics.vehicle_file import read_vehicle, vehicle_toml
from training.card import Card, FlightError
from training.checkpoint import Ranges, Scaling, TrainedModel, save
from training.config import ModelConfig
from training.data.features import body_accelerations, columns
from training.models import named_kind
from training.networks import build_network
from training.recipe import FAST
from vehicles import FOLDER

DT = 0.01
LAG_AND_DRAG = (EffectUse("motor_lag", {"time_constant": 0.04}), EffectUse("linear_drag", {"coefficient": 0.075}))
FLIGHTS, TICKS = 128, 1500
DITHER = 450 * RPM  # deviation of what a tick adds to the commands' dither, for a strength of 1


class Plant:
    """Many quadrotors at once. states: (m, nx), rotor speeds of the lag at the end."""

    def __init__(self, model: Model, many: int) -> None:
        self.model, self.many = model, many
        function = step_function(model, substeps=4, name="plant").map(many)
        self._code = compile_functions([function])[function.name()]
        inputs = self._code.inputs
        inputs["p"][:] = np.tile(model.parameter_values, many)
        inputs["e"][:] = np.tile(ENVIRONMENT_DEFAULT, many)
        inputs["dt"][:] = DT
        self.states = np.tile(model.initial_state(np.array([*[0.0] * 6, 1.0, *[0.0] * 6])), (many, 1))

    def advance(self, speeds: np.ndarray) -> None:
        """10 ms with commanded rotor speeds (m, rotors) rad/s."""
        self._code.inputs["x"][:] = self.states.ravel()
        self._code.inputs["u"][:] = speeds.ravel()
        self._code.run()
        self.states = self._code.outputs["next"].reshape(self.many, -1).copy()


def geometric(vehicle: Vehicle, state: np.ndarray, acceleration: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Rotor speeds (m, rotors) that track accelerations (m, 3), gravity included, at a yaw, by attitude errors."""
    attitude, rate = state[:, 6:10], state[:, 10:13]
    matrix = quaternion.rotation_matrix(attitude)
    force = vehicle.body.mass * np.einsum("mi,mi->m", acceleration, matrix[:, :, 2])
    z = acceleration / np.linalg.norm(acceleration, axis=1, keepdims=True)
    y = np.cross(z, np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], 1))
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    aim = np.stack([np.cross(y, z), y, z], 2)
    skew = np.einsum("mji,mjk->mik", aim, matrix) - np.einsum("mji,mjk->mik", matrix, aim)
    error = 0.5 * np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], 1)
    torque = np.array(vehicle.body.inertia) * (-90 * error - 14 * rate) * np.array([1, 1, 0.5])
    squares = np.concatenate([force[:, None], torque], 1) @ np.linalg.pinv(vehicle.rotors.allocation).T
    return np.sqrt(np.clip(squares, 0, None))


def collect(vehicle: Vehicle, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """States (ticks, flights, 13) and commands (ticks, flights, rotors) of random brisk flights."""
    rng = np.random.default_rng(seed)
    plant = Plant(build_model(vehicle, effects=LAG_AND_DRAG), FLIGHTS)
    phase, pitch = rng.uniform(0, 2 * np.pi, (FLIGHTS, 3, 3)), 2 * np.pi * rng.uniform(0.15, 0.9, (FLIGHTS, 3, 3))
    size = rng.uniform(0.1, 1.0, (FLIGHTS, 3, 3)) * np.array([1.6, 1.6, 0.7])[None, :, None] / (1 + pitch / 2)
    strength, turning = rng.uniform(0.1, 1.2, (FLIGHTS, 1)), rng.uniform(-0.5, 0.5, FLIGHTS)
    dither, states, commands = np.zeros((FLIGHTS, vehicle.rotors.count)), [], []
    low, high = 0.15 * vehicle.hover_speed, vehicle.rotors.speed_max
    for tick in range(TICKS):
        t = tick * DT
        place = (size * np.sin(pitch * t + phase)).sum(-1)
        speed = (size * pitch * np.cos(pitch * t + phase)).sum(-1)
        curve = -(size * pitch**2 * np.sin(pitch * t + phase)).sum(-1)
        now = plant.states
        acceleration = np.clip(curve + 6 * (place - now[:, 0:3]) + 4 * (speed - now[:, 3:6]), -9, 9)
        acceleration[:, 2] += GRAVITY
        dither = 0.9 * dither + DITHER * strength * rng.normal(size=dither.shape)
        rotor_speeds = np.clip(geometric(vehicle, now, acceleration, turning * np.sin(0.7 * t)) + dither, low, high)
        states.append(now[:, :13])
        commands.append(rotor_speeds)
        plant.advance(rotor_speeds)
    trajectory, speeds = np.array(states), np.array(commands)
    brisk = np.isfinite(trajectory).all((0, 2)) & (np.abs(trajectory[:, :, 10:13]).max((0, 2)) < 25)
    return trajectory[:, brisk], speeds[:, brisk]


def train(config: ModelConfig, vehicle: Vehicle, steps: int, seed: int) -> TrainedModel:
    """A network on those flights; its error is that on the last tenth of them."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    states, commands = collect(vehicle, seed)
    inputs = columns(config, states, commands)[:-1]
    rates = np.concatenate([np.diff(states[..., VELOCITY], axis=0), np.diff(states[..., RATE], axis=0)], -1) / DT
    shape = rates.shape
    targets = body_accelerations(rates.reshape(-1, 6), states[:-1, :, ATTITUDE].reshape(-1, 4)).reshape(shape)
    over = (0, 1)
    scaling = Scaling(inputs.mean(over), inputs.std(over), targets.mean(over), targets.std(over))
    features = torch.as_tensor((inputs - scaling.input_mean) / scaling.input_std, dtype=torch.float32).transpose(0, 1)
    targets_std = torch.as_tensor((targets - scaling.output_mean) / scaling.output_std, dtype=torch.float32).transpose(
        0, 1
    )
    network = build_network(config)
    adam = torch.optim.Adam(network.parameters(), 3e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(adam, 3e-3, total_steps=steps, pct_start=0.1)
    learned = int(0.9 * len(features))
    for _ in range(steps):
        windows, labels = _batch(features, targets_std, config.history, rng.integers(0, learned, 512), rng)
        loss = nn.functional.mse_loss(network(windows), labels)
        adam.zero_grad()
        loss.backward()
        adam.step()
        schedule.step()
    network.eval().requires_grad_(requires_grad=False)
    windows, labels = _batch(features, targets_std, config.history, rng.integers(learned, len(features), 20_000), rng)
    miss = ((network(windows) - labels).double().numpy() * scaling.output_std) ** 2
    linear, angular = np.sqrt(miss[:, :3].mean()), np.sqrt(miss[:, 3:].mean())
    spread = float(np.sqrt(np.mean(scaling.output_std**2)))  # what a constant would err by
    error = FlightError("simulated", 20_000, float(linear), float(angular), float(np.sqrt(miss.mean())), spread)
    command = "benchmarks.kernel.network_worker"
    card = Card(config.kind, command, "", FAST, {}, {}, vehicle.name, "", (seed,), (steps,), errors=(error,))
    ranges = Ranges(inputs.min(over), inputs.max(over))
    return TrainedModel(config, (network,), scaling, ranges, vehicle, vehicle_toml(vehicle), card)


def _batch(
    features: torch.Tensor, targets_std: torch.Tensor, history: int, flights: np.ndarray, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor]:
    ends = rng.integers(25, features.shape[1], len(flights))
    rows = torch.as_tensor(ends[:, None] + np.arange(1 - history, 1))
    place = torch.as_tensor(flights)
    return features[place[:, None], rows], targets_std[place, torch.as_tensor(ends)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind")
    parser.add_argument("out", type=Path)
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    vehicle = read_vehicle(FOLDER / "arpl_250g.toml")
    model = train(named_kind(arguments.kind).config, vehicle, arguments.steps, arguments.seed)
    save(model, arguments.out)
    error = model.card.errors[0]
    print(f"{arguments.kind}: {error.linear:.3f} m/s^2, {error.angular:.3f} rad/s^2")


if __name__ == "__main__":
    main()
