"""Checkpoints with random weights, as if they had been trained."""

from __future__ import annotations

import msgspec
import numpy as np
import torch

from dynamics.units import RPM
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import vehicle_toml
from training.card import Card, FlightError
from training.checkpoint import Ranges, Scaling, TrainedModel
from training.config import ModelConfig
from training.networks import build_network
from training.recipe import FAST


def untrained_model(
    config: ModelConfig, vehicle: Vehicle, *, seed: int = 0, members: int = 1, gain: float = 1.0
) -> TrainedModel:
    """A model whose scaling and ranges are those of brisk flight; batch norms are not the identity.

    gain: factor on the network's output.
    """
    networks = []
    for member in range(members if config.network != "none" else 0):
        torch.manual_seed(seed + member)
        network = build_network(config).eval()
        for module in network.modules():
            if isinstance(module, torch.nn.Linear):  # residuals start at zero, torch's default weights shrink inputs
                torch.nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
            if isinstance(module, torch.nn.BatchNorm1d):
                module.running_mean.uniform_(0.1, 0.5)  # type: ignore[union-attr, operator]
                module.running_var.uniform_(0.2, 2.0)  # type: ignore[union-attr, operator]
                module.weight.data.uniform_(0.5, 1.5)
                module.bias.data.uniform_(-0.2, 0.2)
        networks.append(network.requires_grad_(requires_grad=False))
    states = len(config.input_names) - config.rotors
    mean = np.array([*[0.0] * states, *[vehicle.hover_speed] * config.rotors])
    std = np.array([*[2.0] * 3, *[0.4] * (states - 6), *[2.0] * 3, *[800 * RPM] * config.rotors])
    scale = np.array([2.0] * 3 + [10.0] * 3)
    if config.outputs == "wrench":
        scale = scale * np.array([*[vehicle.body.mass] * 3, *vehicle.body.inertia])
    scale = gain * scale
    output_mean = np.array([0.0, 0.0, 9.81 if config.outputs == "body" else 0.0, 0.0, 0.0, 0.0])
    text = vehicle_toml(vehicle)
    card = Card(
        config.kind, "alula train", "2026-01-01", FAST, {"a.csv": "0"}, {"b.csv": "1"}, vehicle.name, "2",
        seeds=(seed,), errors=(FlightError("b.csv", 100, 0.2, 0.5, 0.4, 2.0),),
    )  # fmt: skip
    ranges = Ranges(mean - 4 * std, mean + 4 * std)
    return TrainedModel(
        config, tuple(networks), Scaling(mean, std, output_mean, 0.5 * scale), ranges, vehicle, text, card
    )


def replaced(config: ModelConfig, **overrides: object) -> ModelConfig:
    """A configuration with other values."""
    return msgspec.structs.replace(config, **overrides)
