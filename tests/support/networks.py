"""Networks with random weights, and what they mean, written down a second time in plain NumPy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, RATE, VELOCITY
from export.network import Convolution, Dense, Frame, Network

HOVER_SPEED = 1240.0  # rad/s


def random_network(
    *,
    channels: Sequence[int] = (16, 16, 16, 16),
    taps: int = 3,
    dilations: Sequence[int] = (1, 2, 2, 4),
    hidden: Sequence[int] = (64, 32, 32),
    inputs: Frame = "body",
    outputs: Frame = "body",
    residual: bool = False,
    rotors: int = 4,
    seed: int = 0,
) -> Network:
    """A network whose outputs are about as large and as curved as a trained one's."""
    rng = np.random.default_rng(seed)
    entries = (9 if inputs == "body" else 10) + rotors
    width, convolutions, perceptron = entries, [], []
    for out, dilation in zip(channels, dilations, strict=True):
        weight = rng.normal(size=(out, width, taps)) * np.sqrt(2 / (width * taps))
        convolutions.append(Convolution(weight, 0.1 * rng.normal(size=out), dilation))
        width = out
    for out in (*hidden, 6):
        perceptron.append(Dense(rng.normal(size=(out, width)) * np.sqrt(2 / width), 0.1 * rng.normal(size=out)))
        width = out
    state_mean = [0.0] * 5 + [-1.0] + [0.0] * 3 if inputs == "body" else [0.0] * 3 + [1.0] + [0.0] * 6
    state_std = [2.0] * 3 + [0.3] * 3 + [2.0] * 3 if inputs == "body" else [2.0] * 3 + [0.3] * 4 + [2.0] * 3
    gravity = 9.81 if outputs == "body" and not residual else 0.0
    return Network(
        tuple(convolutions),
        tuple(perceptron),
        np.array([*state_mean, *[HOVER_SPEED] * rotors]),
        np.array([*state_std, *[100.0] * rotors]),
        np.array([0.0, 0.0, gravity, 0.0, 0.0, 0.0]),
        np.array([0.3, 0.3, 0.5, 2.0, 2.0, 0.5]),
        inputs,
        outputs,
        residual,
        rotors,
        0.01,
        1 + (taps - 1) * sum(dilations),
    )


def features(network: Network, columns: Floats) -> Floats:
    """(T, features) standardised, of columns (T, 13 + rotors)."""
    velocity, attitude, rest = columns[:, VELOCITY], columns[:, ATTITUDE], columns[:, RATE.start :]
    if network.inputs == "world":
        raw = np.hstack([velocity, attitude, rest])
    else:
        down = np.tile([0.0, 0.0, -1.0], (len(columns), 1))
        turned = [quaternion.rotate_inverse(attitude, vector) for vector in (velocity, down)]
        raw = np.hstack([*turned, rest])
    return np.asarray((raw - network.input_mean) / network.input_std)


def network_output(network: Network, columns: Floats) -> Floats:
    """The network's output (6,) for a window (receptive field, 13 + rotors), oldest first, layer by layer."""
    values = features(network, columns)
    for layer in network.convolutions:
        taps = layer.weight.shape[2]
        rows = []
        for t in range(layer.reach, len(values)):
            window = np.stack([values[t - (taps - 1 - k) * layer.dilation] for k in range(taps)], axis=1)
            rows.append(np.maximum(0, np.einsum("oik,ik->o", layer.weight, window) + layer.bias))
        values = np.array(rows)
    value = values[-1]
    for i, dense in enumerate(network.perceptron):
        value = dense.weight @ value + dense.bias
        if i + 1 < len(network.perceptron):
            value = np.maximum(0, value)
    return np.asarray(network.output_mean + network.output_std * value)


def accelerations(network: Network, columns: Floats, physics: Floats | None = None) -> Floats:
    """World and body accelerations (6,) after a window. physics: (6,) under a residual."""
    value = network_output(network, columns)
    linear = quaternion.rotate(columns[-1, ATTITUDE], value[:3]) if network.outputs == "body" else value[:3]
    if physics is not None:
        return np.concatenate([linear, value[3:]]) + physics
    return np.concatenate([linear - [0, 0, 9.81 if network.outputs == "body" else 0.0], value[3:]])
