"""Moments of a network's last layer in training: the second moment of its inputs, where an update in flight begins.

With inputs h of the last layer and phi = (h, 1), weights of one output have from m rows with noise of variance s^2 the
covariance s^2 / m M^-1, M = mean of phi phi' (Bishop, Pattern Recognition and Machine Learning, 2006, eq. 3.51): in
M's metric a change is as long as the training would have noticed it.

python -m training.last_layer MODEL.pt LOG... adds the moments to a model that was trained before there were any.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from dynamics.arrays import Floats
from training.checkpoint import TrainedModel, load, save
from training.data.labelled_rows import LabelledRows, label_rows
from training.data.logged_flights import find_logs, read_logged_flights

BATCH = 8192  # windows


def feature_moments(model: TrainedModel, data: LabelledRows) -> tuple[Floats, ...]:
    """Of each member the mean (n + 1, n + 1) of phi phi' over a data set's windows, n inputs of its last layer.

    Empty for networks without a hidden layer, whose last one has no features of its own.
    """
    if not model.config.hidden:
        return ()
    return tuple(_moment(model, network, data) for network in model.networks)


def last_inputs(model: TrainedModel, network: nn.Module, windows: Floats) -> Floats:
    """(m, n) inputs of a member's last layer for windows (m, T, inputs) in their units."""
    captured: list[Tensor] = []
    scaling = model.scaling
    handle = last_layer(network).register_forward_pre_hook(lambda _, arguments: captured.append(arguments[0]))
    standardised = (torch.as_tensor(windows) - torch.from_numpy(scaling.input_mean)) / torch.from_numpy(
        scaling.input_std
    )
    with torch.no_grad():
        network(standardised.float())
    handle.remove()
    return np.asarray(captured[0].double().numpy())


def last_layer(network: nn.Module) -> nn.Linear:
    """The layer that gives the outputs."""
    layer = network.decoder[-1]  # type: ignore[index]
    assert isinstance(layer, nn.Linear)
    return layer


def _moment(model: TrainedModel, network: nn.Module, data: LabelledRows) -> Floats:
    ends, offsets = data.ends, np.arange(1 - model.config.history, 1)
    size = last_layer(network).in_features + 1
    total = np.zeros((size, size))
    for start in range(0, len(ends), BATCH):
        inputs = last_inputs(model, network, data.inputs[ends[start : start + BATCH, None] + offsets])
        phi = np.hstack([inputs, np.ones((len(inputs), 1))])
        total += phi.T @ phi
    return total / len(ends)


def main() -> None:
    """Add the moments of the flights that a model's card names, among the logs, to its file."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("logs", type=Path, nargs="+")
    arguments = parser.parse_args()
    model = load(arguments.model)
    paths = [path for path in find_logs(arguments.logs) if path.name in model.card.flights]
    data = label_rows(model.config, model.vehicle, read_logged_flights(paths, dt=model.config.dt))
    save(dataclasses.replace(model, moments=feature_moments(model, data)), arguments.model)
    print(f"{arguments.model}: {len(model.networks)} members, {len(data.ends)} windows of {len(paths)} flights")


if __name__ == "__main__":
    main()
