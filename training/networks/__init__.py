"""The networks, from standardised windows to standardised outputs; `training.checkpoint` converts units."""

from __future__ import annotations

from torch import nn

from dynamics.errors import RequestError
from training.config import ModelConfig
from training.networks.mlp import WindowPerceptron
from training.networks.tcn import TemporalConvolution


def build_network(config: ModelConfig) -> nn.Module:
    """An untrained network for (m, T, inputs) windows, oldest column first, giving (m, 6). Weights by torch's seed.

    The first output of one that adds to a base is zero. Raises RequestError for a model without a network.
    """
    if config.network == "none":
        raise RequestError(f"{config.kind} has no network: it is evaluated, not trained.")
    network = TemporalConvolution(config) if config.network == "tcn" else WindowPerceptron(config)
    if config.base != "none":
        last = network.decoder[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
    return network
