"""The split of a network: layers that a kernel propagates tangents through, and layers differentiated backwards.

Tangents have many columns, a network's output has six rows. Propagating tangents through a layer costs taps x inputs x
outputs for every column; differentiating it backwards costs six times as much for every column of the window that
reaches the output, but not for every direction of the tangents, and the result is kept as long as no ReLU switches
(docs/kernel.md).
"""

from __future__ import annotations

from dataclasses import dataclass

from export.network import Network

ROWS = 6
RECOMPUTED_SHARE = 0.5  # of the backward pass, by a substep: 0.1 in calm flight, more where motors saturate


@dataclass(frozen=True)
class ReverseSplit:
    """The first `streamed_layers` layers propagate tangents, the others are differentiated backwards.

    offsets: for each layer differentiated backwards, and for the perceptron, the columns of its input that reach the
        output, counted back from the newest.
    taps: for each such layer and each column of its output, the index into `offsets` of each tap's input.
    """

    streamed_layers: int
    offsets: tuple[tuple[int, ...], ...]
    taps: tuple[tuple[tuple[int, ...], ...], ...]


def split_after(network: Network, streamed_layers: int) -> ReverseSplit:
    """The split with so many streamed layers."""
    offsets: list[tuple[int, ...]] = [(0,)]
    taps: list[tuple[tuple[int, ...], ...]] = []
    for layer in reversed(network.convolutions[streamed_layers:]):
        steps = [tap * layer.dilation for tap in range(layer.weight.shape[2])]
        below = tuple(sorted({back + step for back in offsets[0] for step in steps}))
        taps.insert(0, tuple(tuple(below.index(back + step) for step in steps) for back in offsets[0]))
        offsets.insert(0, below)
    return ReverseSplit(streamed_layers, tuple(offsets), tuple(taps))


def cheapest_split(network: Network, nodes: int) -> ReverseSplit:
    """The split with the fewest operations at a substep in the middle of a horizon of so many nodes."""
    directions = network.features - network.rotors + network.rotors * (nodes + 1) / 2
    splits = [split_after(network, count) for count in range(len(network.convolutions) + 1)]
    return min(splits, key=lambda split: _cost(network, split, directions))


def _cost(network: Network, split: ReverseSplit, directions: float) -> float:
    """Multiplications and additions at a substep, all ReLUs active."""
    count = split.streamed_layers
    sizes = [layer.weight.size for layer in network.convolutions]
    moving = network.features - network.rotors  # inputs' own features are identities
    if count:
        sizes[0] = sizes[0] * moving // network.features
    width = network.convolutions[count - 1].weight.shape[0] if count else moving
    forward = sum(sizes[:count]) + ROWS * width * len(split.offsets[0])
    backward = sum(ROWS * size * len(above) for size, above in zip(sizes[count:], split.offsets[1:], strict=True))
    return directions * forward + RECOMPUTED_SHARE * backward
