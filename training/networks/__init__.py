"""The networks, which see standardised windows and speak standardised outputs; units live outside."""

from __future__ import annotations

from torch import nn

from dynamics.errors import RequestError
from training.config import ModelConfig
from training.networks.mlp import WindowPerceptron
from training.networks.tcn import TemporalConvolution


def build_network(config: ModelConfig) -> nn.Module:
    """An untrained network for (m, T, inputs) windows, oldest column first, giving (m, 6). Weights by torch's seed.

    Raises RequestError for a model without a network.
    """
    if config.network == "tcn":
        return TemporalConvolution(config)
    if config.network == "mlp":
        return WindowPerceptron(config)
    raise RequestError(f"{config.kind} has no network: it is evaluated, not trained.")
