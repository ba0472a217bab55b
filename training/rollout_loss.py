"""Multi-step training: the streamed network predicts its own inputs over some steps of dt.

Only kinematics are computed here: velocity, body rates and attitude follow from the predicted accelerations, the motors
are the recorded ones, and a base stays at its values along the recording. The change of velocity and body rates since
the first step is compared with the sum of the labels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from dynamics import quaternion
from dynamics.errors import DataError
from dynamics.kinematics import kinematic_step
from dynamics.network_inputs import state_inputs
from dynamics.state import ATTITUDE
from dynamics.vehicle import GRAVITY, Vehicle
from training.checkpoint import Scaling
from training.config import ModelConfig
from training.data.features import body_inertia, world_accelerations
from training.data.labelled_rows import LabelledRows
from training.data.tensors import Tensors, with_noise
from training.streaming import Stream


@dataclass(frozen=True, eq=False)
class RolloutLoss:
    """Recorded flights for roll-outs.

    state: (n, 13).
    base: (n, 6) body accelerations.
    label: (n, 6) world accelerations.
    starts: (m,) rows at which a roll-out of `steps` steps may begin.
    output_unit: (6,) outputs over accelerations.
    error_std: (6,) unit of their error.
    noise: deviation added to the standardised state.
    """

    config: ModelConfig
    tensors: Tensors
    scaling: dict[str, Tensor]
    state: Tensor
    base: Tensor
    label: Tensor
    starts: Tensor
    output_unit: Tensor
    error_std: Tensor
    steps: int
    noise: float

    @classmethod
    def of(
        cls,
        config: ModelConfig,
        vehicle: Vehicle,
        data: LabelledRows,
        tensors: Tensors,
        scaling: Scaling,
        steps: int,
        noise: float,
    ) -> RolloutLoss:
        """Raises DataError when no segment of the flights is as long as a roll-out."""
        device = tensors.inputs.device
        last_rows = data.ends + (steps - 1)
        starts = data.ends[np.isin(last_rows, data.ends) & (_run_length(data.ends) >= steps)]
        if not len(starts):
            raise DataError(f"no segment of the flights has {steps} rows with labels after a whole history.")
        world = world_accelerations(data.label, data.state[:, ATTITUDE])
        base = np.zeros_like(data.label) if data.base_labelled is None else data.base_labelled

        def tensor(values: np.ndarray) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(values)).to(device, torch.float32)

        output_unit = body_inertia(vehicle) if config.outputs == "wrench" else np.ones(6)
        scales = {name: tensor(getattr(scaling, name)) for name in Scaling.__dataclass_fields__}
        return cls(
            config,
            tensors,
            scales,
            tensor(data.state),
            tensor(base),
            tensor(world),
            torch.from_numpy(starts).to(device),
            tensor(output_unit),
            tensor(scaling.output_std / output_unit),
            steps,
            noise,
        )

    def loss(self, network: nn.Module, chosen: Tensor, generator: torch.Generator) -> Tensor:
        """Mean over the steps of the squared error of the mean acceleration up to each, in standardised units.

        Errors of a model with outputs in body axes are taken in those of the first step, so that a single step has
        the one-step loss.

        chosen: (b,) numbers that pick starts, modulo their count.
        """
        rows = self.starts[chosen % len(self.starts)]
        stream = Stream(network, self.config)
        windows = with_noise(self.tensors.windows(rows), self.config.state_inputs, self.noise, generator)
        for column in windows[:, :-1].unbind(1):
            stream.push(column)
        column, state = windows[:, -1], self.state[rows]
        back = None if self.config.outputs == "world" else quaternion.conjugate(state[:, ATTITUDE])
        error, total = torch.zeros(len(rows), 6, device=rows.device), torch.zeros((), device=rows.device)
        for step in range(self.steps):
            outputs = stream.push(column)
            assert outputs is not None
            world = self._world(outputs, self.base[rows + step], state[:, ATTITUDE])
            error = error + (world - self.label[rows + step])
            counted = error if back is None else torch.cat([quaternion.rotate(back, error[:, :3]), error[:, 3:]], 1)
            total = total + (counted / ((step + 1) * self.error_std)).square().mean()
            state = kinematic_step(state, world[:, :3], world[:, 3:], self.config.dt)
            if step + 1 < self.steps:
                column = self._column(state, self.tensors.inputs[rows + step + 1])
        return total / self.steps

    def _world(self, outputs: Tensor, base: Tensor, attitude: Tensor) -> Tensor:
        """World acceleration and angular acceleration (b, 6) that standardised outputs stand for."""
        accelerations = (outputs * self.scaling["output_std"] + self.scaling["output_mean"]) / self.output_unit
        if self.config.outputs == "world":
            if self.config.base == "none":
                return accelerations
            return accelerations + self._world_axes(base, attitude)
        body = base + accelerations
        return self._world_axes(body, attitude)

    @staticmethod
    def _world_axes(body: Tensor, attitude: Tensor) -> Tensor:
        """Body accelerations (b, 6) as world and angular acceleration."""
        gravity = torch.tensor([0.0, 0.0, GRAVITY], device=body.device)
        return torch.cat([quaternion.rotate(attitude, body[:, :3]) - gravity, body[:, 3:]], 1)

    def _column(self, state: Tensor, recorded: Tensor) -> Tensor:
        """A standardised column of a predicted state with the recorded motors."""
        inputs: Tensor = state_inputs(self.config.inputs, state)
        width = inputs.shape[1]
        standardised = (inputs - self.scaling["input_mean"][:width]) / self.scaling["input_std"][:width]
        return torch.cat([standardised, recorded[:, width:]], 1)


def _run_length(ends: np.ndarray) -> np.ndarray:
    """(m,) how many consecutive rows begin at each of the ends."""
    breaks = np.flatnonzero(np.diff(ends) != 1)
    last = np.append(breaks, len(ends) - 1)
    return np.asarray(last[np.searchsorted(last, np.arange(len(ends)))] - np.arange(len(ends)) + 1)
