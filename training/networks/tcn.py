"""PI-TCN's network: dilated causal convolutions over a window, a perceptron on the last position (section III-B).

Only the receptive cone of the newest column is evaluated: a layer works out every g-th position, g the greatest common
divisor of the dilations that follow. For kernel 3 and dilations 1, 2, 2, 4 these are 9, 7, 3 and 1 positions instead
of 20 each. No position is ever padded, so a network evaluated column by column gives the same.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from training.config import ModelConfig
from training.networks.mlp import perceptron


class CausalConvolution(nn.Module):
    """One layer: taps side by side, linear, ReLU, batch norm, dropout (section IV-B).

    linear.weight: (channels, kernel * inputs), the oldest tap's inputs first.
    """

    def __init__(self, inputs: int, config: ModelConfig, *, dilation: int, stride: int) -> None:
        super().__init__()
        self.kernel, self.dilation, self.stride = config.kernel, dilation, stride
        self.linear = nn.Linear(config.kernel * inputs, config.channels)
        self.norm = nn.BatchNorm1d(config.channels) if config.batch_norm else None
        self.dropout = nn.Dropout(config.dropout)

    def forward(self, columns: Tensor) -> Tensor:
        """(m, positions, inputs) -> (m, fewer positions, channels), the last position for the last column."""
        last = columns.shape[1] - 1
        count = (last - (self.kernel - 1) * self.dilation) // self.stride + 1
        reach = self.stride * (count - 1)
        ends = [last - (self.kernel - 1 - tap) * self.dilation for tap in range(self.kernel)]
        taps = torch.cat([columns[:, end - reach : end + 1 : self.stride] for end in ends], dim=2)
        return self.activate(self.linear(taps))

    def activate(self, sums: Tensor) -> Tensor:
        """Activation after the linear map. sums: (m, positions, channels)."""
        activated = torch.relu(sums)
        if self.norm is not None:
            activated = self.norm(activated.flatten(0, 1)).view_as(activated)
        dropped: Tensor = self.dropout(activated)
        return dropped


class TemporalConvolution(nn.Module):
    """Convolutions and decoder. Input: (m, T, inputs) windows, oldest column first."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.receptive_field = config.receptive_field
        widths = (len(config.input_names), *[config.channels] * len(config.dilations))
        # spacing[l]: distance in columns between the positions that layer l is given; the last one needs no more
        spacing = [math.gcd(*config.dilations[layer:]) for layer in range(len(config.dilations))]
        spacing = [1, *spacing[1:], config.dilations[-1]]
        self.layers = nn.ModuleList(
            CausalConvolution(
                widths[layer], config, dilation=dilation // spacing[layer], stride=spacing[layer + 1] // spacing[layer]
            )
            for layer, dilation in enumerate(config.dilations)
        )
        self.decoder = perceptron(config.channels, config.hidden, 6)

    def forward(self, windows: Tensor) -> Tensor:
        """(m, T, inputs) standardised -> (m, 6) standardised."""
        columns = windows[:, -self.receptive_field :]
        for layer in self.layers:
            columns = layer(columns)
        outputs: Tensor = self.decoder(columns[:, -1])
        return outputs
