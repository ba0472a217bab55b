"""A network as plain numbers in SI units, from which every backend is written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import RequestError
from dynamics.network_inputs import STATE_INPUTS, Frame

WIDEST_LAYER = 240  # the kernel counts active entries in bytes


@dataclass(frozen=True, eq=False)
class Convolution:
    """A causal convolution with ReLU. weight: (outputs, inputs, taps), oldest tap first. bias: (outputs,)."""

    weight: Floats
    bias: Floats
    dilation: int

    @property
    def reach(self) -> int:
        """Columns that the oldest tap lies behind the newest."""
        return int((self.weight.shape[2] - 1) * self.dilation)


@dataclass(frozen=True, eq=False)
class Dense:
    """A linear layer; all but a network's last are followed by ReLU. weight: (outputs, inputs). bias: (outputs,)."""

    weight: Floats
    bias: Floats


@dataclass(frozen=True, eq=False)
class Network:
    """Convolutions over columns, a perceptron on the last position; standardised inside, SI outside.

    convolutions, perceptron: the layers in order.
    input_mean, input_std: (columns' entries,) standardised = (value - input_mean) / input_std.
    output_mean, output_std: (6,) output = output_mean + output_std * standardised output: acceleration (3) m/s^2 and
        angular acceleration (3) rad/s^2, of the vehicle, or of a residual what is added to a physical model's.
    inputs: frame of a column's entries (`dynamics.network_inputs`), which rotor speeds, rad/s, follow.
    outputs: "world": acceleration in world axes; "body": specific force in body axes, or a residual in body axes.
    residual: whether the output is added to a physical model's accelerations.
    rotors: of the vehicle.
    dt: s between columns.
    history: T columns of a window.
    """

    convolutions: tuple[Convolution, ...]
    perceptron: tuple[Dense, ...]
    input_mean: Floats
    input_std: Floats
    output_mean: Floats
    output_std: Floats
    inputs: Frame
    outputs: Frame
    residual: bool
    rotors: int
    dt: float
    history: int

    def __post_init__(self) -> None:
        """Refuse what no backend could evaluate."""
        entries = len(STATE_INPUTS[self.inputs]) + self.rotors
        width = self._chain(entries)
        if width != 6 or self.output_mean.shape != (6,) or self.output_std.shape != (6,):
            raise RequestError(
                f"the network gives {width} outputs, required are 6: acceleration and angular acceleration."
            )
        if self.input_mean.shape != (entries,) or self.input_std.shape != (entries,):
            raise RequestError(f"the scaling is for {self.input_mean.size} inputs, the columns have {entries}.")
        if self.receptive_field > self.history:
            raise RequestError(
                f"the network looks back {self.receptive_field} columns, its windows have {self.history}: zero padding "
                "would enter and streaming be wrong. Train it with smaller dilations or a longer history."
            )
        bad = [name for name, values in self._arrays() if not np.isfinite(values).all()]
        if bad:
            raise RequestError(f"weights that are not finite in {', '.join(bad)}: the training diverged. Train again.")
        if (self.input_std <= 0).any():
            raise RequestError("an input's deviation is not positive: it never changed in training. Train on more.")

    def _chain(self, width: int) -> int:
        """Outputs of the last layer. Raises RequestError where a layer does not fit the one before."""
        for name, layer in self.layers:
            wide = layer.weight.shape[0]
            if layer.weight.shape[1] != width or layer.bias.shape != (wide,):
                raise RequestError(f"{name} takes {layer.weight.shape[1]} entries, its input has {width}.")
            if wide > WIDEST_LAYER:
                raise RequestError(f"{name} has {wide} outputs, the kernel takes at most {WIDEST_LAYER}.")
            width = wide
        return width

    def _arrays(self) -> list[tuple[str, Floats]]:
        weights = [(name, part) for name, layer in self.layers for part in (layer.weight, layer.bias)]
        scaling = ("input_mean", "input_std", "output_mean", "output_std")
        return [*weights, *((name, getattr(self, name)) for name in scaling)]

    @property
    def layers(self) -> list[tuple[str, Convolution | Dense]]:
        """All layers in order, with names for messages."""
        convolutions = [(f"convolution {i}", layer) for i, layer in enumerate(self.convolutions)]
        return [*convolutions, *((f"dense {i}", layer) for i, layer in enumerate(self.perceptron))]

    @property
    def receptive_field(self) -> int:
        """Columns that an output depends on, its own included."""
        return 1 + sum(layer.reach for layer in self.convolutions)

    @property
    def features(self) -> int:
        """Entries of a column."""
        return int(self.input_mean.size)


@dataclass(frozen=True, eq=False)
class Ensemble:
    """The members that do not fly: where they disagree with the one that does, none of them knows.

    others: of the flown network's shape, with its scaling.
    limit: RMS over the outputs of the members' standardised deviation from which on a residual fades.
    fades: whether it does, as in training; where not, the disagreement is recorded alone.
    """

    others: tuple[Network, ...]
    limit: float
    fades: bool
