"""Training data as standardised tensors on one device, stored once; windows are index arithmetic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from dynamics.arrays import Floats
from dynamics.units import RPM
from dynamics.vehicle import Vehicle
from training.checkpoint import Scaling
from training.config import ModelConfig
from training.data.collocation import CollocationPoints
from training.data.features import body_inertia
from training.data.labelled_rows import LabelledRows
from training.recipe import Recipe

PAPER_ROTOR_UNIT = 1000 * RPM  # of the paper's raw inputs (supplementary material), rad/s


@dataclass(frozen=True, eq=False)
class Tensors:
    """Standardised rows of all flights.

    inputs: (n, k).
    targets: (n, 6).
    ends: (m,) rows that windows end at.
    history: T columns of a window.
    """

    inputs: Tensor
    targets: Tensor
    ends: Tensor
    history: int

    @classmethod
    def of(cls, data: LabelledRows, scaling: Scaling, history: int, device: torch.device) -> Tensors:
        """A data set, standardised."""
        inputs = torch.from_numpy((data.inputs - scaling.input_mean) / scaling.input_std).float()
        targets = torch.from_numpy((data.targets - scaling.output_mean) / scaling.output_std).float()
        return cls(inputs.to(device), targets.to(device), torch.from_numpy(data.ends).to(device), history)

    def windows(self, ends: Tensor) -> Tensor:
        """(m, T, k) windows, oldest column first, that end at these rows."""
        offsets = torch.arange(1 - self.history, 1, device=ends.device)
        return self.inputs[ends[:, None] + offsets]


@dataclass(frozen=True, eq=False)
class CollocationTensors:
    """The points of the physics-inspired loss, standardised. windows, unperturbed: (p, T, k). targets: (p, 6)."""

    windows: Tensor
    targets: Tensor
    unperturbed: Tensor | None

    @classmethod
    def of(cls, points: CollocationPoints, scaling: Scaling, device: torch.device) -> CollocationTensors:
        """CollocationPoints, standardised as the flights are."""

        def columns(values: Floats) -> Tensor:
            return torch.from_numpy((values - scaling.input_mean) / scaling.input_std).float().to(device)

        mean = scaling.output_mean if points.unperturbed is None else 0  # the mean cancels in differences
        targets = torch.from_numpy((points.targets - mean) / scaling.output_std).float().to(device)
        return cls(
            columns(points.windows), targets, None if points.unperturbed is None else columns(points.unperturbed)
        )

    def loss(self, learner: nn.Module, windows: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """(the learner's outputs for windows, mean squared standardised error on these points), in one call."""
        parts = [windows, self.windows[rows]] + ([] if self.unperturbed is None else [self.unperturbed[rows]])
        outputs = learner(torch.cat(parts))
        predicted = outputs[len(windows) : len(windows) + len(rows)]
        if self.unperturbed is not None:
            predicted = predicted - outputs[len(windows) + len(rows) :]
        return outputs[: len(windows)], (predicted - self.targets[rows]).square().mean()


def with_noise(windows: Tensor, measured: int, deviation: float, generator: torch.Generator) -> Tensor:
    """Windows (m, T, k) whose first `measured` entries of every column carry noise; rotor speeds are exact.

    A network with a history learns from precise recordings to differentiate them. In flight, columns are partly
    predicted, the controller exploits such slopes, and the closed loop becomes unstable.
    """
    if deviation == 0:
        return windows
    noise = torch.randn((*windows.shape[:2], measured), generator=generator).to(windows.device)
    return windows + deviation * torch.nn.functional.pad(noise, (0, windows.shape[2] - measured))


def make_scaling(config: ModelConfig, recipe: Recipe, vehicle: Vehicle, data: LabelledRows) -> Scaling:
    """Mean and deviation of inputs and targets over the training windows.

    Without standardising, numbers are raw as the paper's: mean 0 and deviation 1, rotor speeds in thousands of rpm.

    Residuals keep 0 as their mean, so that a network whose output is 0 leaves the base as it is. Raw residual force and
    torque are in units of mass and inertia, so that the loss is of accelerations.
    """
    inputs, targets = data.inputs[data.ends], data.targets[data.ends]
    if not recipe.standardise:
        output_unit = body_inertia(vehicle) if config.outputs == "wrench" else np.ones(6)
        units = np.ones(inputs.shape[1])
        units[config.state_inputs :] = PAPER_ROTOR_UNIT
        return Scaling(np.zeros(inputs.shape[1]), units, np.zeros(6), output_unit)
    mean = targets.mean(axis=0) if config.base == "none" else np.zeros(6)
    return Scaling(inputs.mean(axis=0), _deviation(inputs), mean, _deviation(targets))


def _deviation(values: np.ndarray) -> np.ndarray:
    """(k,) standard deviations, 1 for constant entries."""
    deviation = values.std(axis=0)
    return np.where(deviation > 1e-9 * (1 + np.abs(values).max(axis=0)), deviation, 1.0)
