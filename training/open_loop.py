"""Open-loop simulation of a trained model: many flights at once, each from its own recorded history."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.kinematics import kinematic_step
from dynamics.state import ATTITUDE
from training.checkpoint import TrainedModel
from training.config import ModelConfig
from training.data.features import accelerations_from, columns, world_accelerations
from training.physics import BatchModel
from training.prediction import gate_of
from training.streaming import Stream

WARM_UP = 40  # columns of recorded history that hidden states settle in: 0.4 s, eleven lags of 35 ms


class OpenLoopSimulation:
    """A model at m starts. state: (m, 13) of the rigid bodies now; `step` moves on by dt."""

    def __init__(self, model: TrainedModel, states: Floats, rotor_speed: Floats) -> None:
        """states: (m, W, 13) recorded, the last one where the simulation begins. rotor_speed: (m, W - 1, rotors) rad/s.

        W: at least `warm_up(model.config)`.
        """
        config = model.config
        self._model = model
        self._streams = [Stream(network, config) for network in model.networks]
        self._base: BatchModel | None = None
        if config.base != "none":
            effects = model.vehicle.effects if config.base == "grey_box" else ()
            self._base = BatchModel(
                model.vehicle,
                effects,
                rotor_speed[:, 0],
                dt=config.dt,
                label=config.label,
                motors=config.motors,
            )
        for column in range(rotor_speed.shape[1]):
            self._accelerations(states[:, column], rotor_speed[:, column])
        self.state = states[:, -1].copy()

    def step(self, rotor_speed: Floats) -> None:
        """Let dt pass with these rotor speeds (m, rotors), rad/s."""
        dt, before = self._model.config.dt, self.state
        body = self._accelerations(before, rotor_speed)
        world = world_accelerations(body, before[:, ATTITUDE])
        self.state = kinematic_step(before, world[:, :3], world[:, 3:], dt)
        self.state[:, ATTITUDE] = quaternion.normalise(self.state[:, ATTITUDE])

    def _accelerations(self, state: Floats, rotor_speed: Floats) -> Floats:
        """(m, 6) body accelerations; zeros in the warm-up of a network without enough columns yet."""
        model, config = self._model, self._model.config
        base = None if self._base is None else self._base(state, rotor_speed).body
        if not self._streams:
            assert base is not None
            return base
        scaling = model.scaling
        column = (columns(config, state, rotor_speed) - scaling.input_mean) / scaling.input_std
        standardised = torch.from_numpy(column).float()
        with torch.no_grad():
            predictions = [stream.push(standardised) for stream in self._streams]
        ready = [value.double().numpy() for value in predictions if isinstance(value, Tensor)]
        if not ready:
            return np.zeros((len(state), 6))
        outputs = np.stack(ready) * scaling.output_std + scaling.output_mean
        mean = outputs.mean(axis=0)
        if config.base == "grey_box" and len(outputs) > 1 and model.reliability is not None:
            spread = outputs.std(axis=0, ddof=1) / scaling.output_std
            gate = gate_of(np.sqrt(np.mean(spread**2, axis=1)), model.reliability.disagreement)
            mean = gate[:, None] * mean
        return accelerations_from(config, model.vehicle, mean, base, state[:, ATTITUDE])


def warm_up(config: ModelConfig) -> int:
    """Columns of history that a simulation has to be given."""
    return max(WARM_UP, config.history) + 1
