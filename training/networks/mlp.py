"""The perceptron: PI-TCN's decoder, and on a flattened window a network of its own (PI-MLP)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from torch import Tensor, nn

from training.config import ModelConfig


def perceptron(inputs: int, hidden: Sequence[int], outputs: int) -> nn.Sequential:
    """Linear layers with ReLU between them (PI-TCN section IV-B)."""
    widths = (inputs, *hidden)
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*layers, nn.Linear(widths[-1], outputs))


class WindowPerceptron(nn.Module):
    """All columns of a window, oldest first, side by side into one perceptron."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.decoder = perceptron(config.history * len(config.input_names), config.hidden, 6)

    def forward(self, windows: Tensor) -> Tensor:
        """(m, T, inputs) standardised -> (m, 6) standardised."""
        outputs: Tensor = self.decoder(windows.flatten(1))
        return outputs
