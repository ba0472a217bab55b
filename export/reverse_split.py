"""Which layers of a network a kernel streams tangents through, and from which on it sweeps back instead.

Tangents have many columns, what the network says has six rows. Streaming a layer costs taps x inputs x outputs for
every column; sweeping it costs six times as much for every column of the window in which the layer is seen, but not
for every direction of the tangents, and a sweep is kept as long as no ReLU turns (docs/kernel.md).
"""

from __future__ import annotations

from dataclasses import dataclass

from export.network import Network

ROWS = 6
SWEPT_ANEW = 0.5  # of a sweep is worked out anew at a substep: a tenth in calm flight, more where motors saturate


@dataclass(frozen=True)
class Sweep:
    """The first `streamed` layers are streamed, the others swept.

    seen: by swept layer and for what the perceptron is given, how many columns back from the newest its input is seen.
    reached: by swept layer, for each column at which its output is seen and each tap the place in `seen` of its input.
    """

    streamed: int
    seen: tuple[tuple[int, ...], ...]
    reached: tuple[tuple[tuple[int, ...], ...], ...]


def sweep_of(network: Network, streamed: int) -> Sweep:
    """The sweep that leaves so many layers streamed."""
    seen: list[tuple[int, ...]] = [(0,)]
    reached: list[tuple[tuple[int, ...], ...]] = []
    for layer in reversed(network.convolutions[streamed:]):
        steps = [tap * layer.dilation for tap in range(layer.weight.shape[2])]
        below = tuple(sorted({back + step for back in seen[0] for step in steps}))
        reached.insert(0, tuple(tuple(below.index(back + step) for step in steps) for back in seen[0]))
        seen.insert(0, below)
    return Sweep(streamed, tuple(seen), tuple(reached))


def cheapest_sweep(network: Network, nodes: int) -> Sweep:
    """The sweep with the fewest operations at a substep in the middle of a horizon of so many nodes."""
    directions = network.features - network.rotors + network.rotors * (nodes + 1) / 2
    sweeps = [sweep_of(network, streamed) for streamed in range(len(network.convolutions) + 1)]
    return min(sweeps, key=lambda sweep: _cost(network, sweep, directions))


def _cost(network: Network, sweep: Sweep, directions: float) -> float:
    """Multiplications and additions at a substep, all ReLUs active."""
    sizes = [layer.weight.size for layer in network.convolutions]
    moving = network.features - network.rotors  # inputs' own features are identities
    if sweep.streamed:
        sizes[0] = sizes[0] * moving // network.features
    given = network.convolutions[sweep.streamed - 1].weight.shape[0] if sweep.streamed else moving
    pushed = sum(sizes[: sweep.streamed]) + ROWS * given * len(sweep.seen[0])
    pulled = sum(ROWS * size * len(above) for size, above in zip(sizes[sweep.streamed :], sweep.seen[1:], strict=True))
    return directions * pushed + SWEPT_ANEW * pulled
