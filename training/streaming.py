"""A network evaluated column by column: each layer keeps the few columns that its taps still reach.

A column of PI-TCN costs 7.3k multiplications this way, its window's cone 18.8k. With a receptive field of at most T
columns the outputs are those of the windows.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from training.config import ModelConfig
from training.networks.mlp import WindowPerceptron
from training.networks.tcn import CausalConvolution, TemporalConvolution


class Stream:
    """The memory of a network over m flights at once. Differentiable: nothing is written in place."""

    def __init__(self, network: nn.Module, config: ModelConfig) -> None:
        self._network = network
        self._config = config
        self._memory: list[list[Tensor]] = [[] for _ in config.dilations] if config.network == "tcn" else [[]]
        self.columns = 0

    @property
    def is_ready(self) -> bool:
        """Whether the network has all columns that an output depends on."""
        return self.columns >= self._config.receptive_field

    def push(self, column: Tensor) -> Tensor | None:
        """The outputs (m, 6) at a new column (m, inputs), both standardised; None until enough columns have come."""
        self.columns += 1
        if isinstance(self._network, TemporalConvolution):
            return self._push_layers(self._network, column)
        if not isinstance(self._network, WindowPerceptron):
            raise TypeError(f"{type(self._network).__name__} cannot be streamed")
        window = self._remember(0, column, self._config.history)
        if not self.is_ready:
            return None
        outputs: Tensor = self._network.decoder(torch.cat(window, dim=1))
        return outputs

    def _push_layers(self, network: TemporalConvolution, column: Tensor) -> Tensor | None:
        kernel = self._config.kernel
        for place, (layer, dilation) in enumerate(zip(network.layers, self._config.dilations, strict=True)):
            assert isinstance(layer, CausalConvolution)
            inputs = self._remember(place, column, (kernel - 1) * dilation + 1)
            if len(inputs) <= (kernel - 1) * dilation:
                return None
            sums = layer.linear(torch.cat(inputs[::dilation], dim=1))
            column = layer.activate(sums[:, None])[:, 0]
        outputs: Tensor = network.decoder(column)
        return outputs

    def _remember(self, place: int, column: Tensor, length: int) -> list[Tensor]:
        self._memory[place] = [*self._memory[place][-(length - 1) :], column] if length > 1 else [column]
        return self._memory[place]
