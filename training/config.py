"""The definition of a model: inputs, outputs, base, network. How it is trained is in `training.recipe`."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from dynamics.errors import RequestError
from dynamics.network_inputs import STATE_INPUTS, Frame

Base = Literal["none", "nominal", "grey_box"]
Label = Literal["instantaneous", "mean_increment"]
Network = Literal["tcn", "mlp", "none"]
Outputs = Literal["world", "body", "wrench"]
Motors = Literal["command", "measured"]
Count = Annotated[int, Meta(ge=1)]

OUTPUTS: dict[Outputs, tuple[str, ...]] = {
    "world": ("acceleration_x", "acceleration_y", "acceleration_z"),
    "body": ("specific_force_x", "specific_force_y", "specific_force_z"),
    "wrench": ("force_x", "force_y", "force_z"),
}
ANGULAR = ("angular_acceleration_x", "angular_acceleration_y", "angular_acceleration_z")
TORQUE = ("torque_x", "torque_y", "torque_z")


class ModelConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A model's definition: everything that determines shape and meaning of its numbers.

    kind: its name in `training.models`.
    network: "none" for a model that is only evaluated.
    base: what the network's output is added to.
    inputs: frame of the columns (`input_names`).
    outputs: "world": accelerations in the world frame; "body": specific force and angular acceleration in the body
        frame; "wrench": residual force and torque (supplement eq. 1).
    motors: commanded or measured rotor speeds.
    label: accelerations at the newest column, or their mean over the next dt.
    filtered_inputs: whether the inputs carry the paper's zero-phase filter, which does not exist in flight.
    rotors: of the vehicle.
    dt: s between columns.
    history: T columns of a window.
    channels, kernel, dilations: of the convolutions.
    hidden: widths of the perceptron's layers.
    batch_norm, dropout: of the convolutions, in training.
    """

    kind: str
    network: Network
    base: Base = "none"
    inputs: Frame = "body"
    outputs: Outputs = "body"
    motors: Motors = "command"
    label: Label = "mean_increment"
    filtered_inputs: bool = False
    rotors: Count = 4
    dt: Annotated[float, Meta(gt=0)] = 0.01
    history: Count = 20
    channels: Count = 16
    kernel: Count = 3
    dilations: tuple[Count, ...] = (1, 2, 2, 4)
    hidden: tuple[Count, ...] = (64, 32, 32)
    batch_norm: bool = False
    dropout: Annotated[float, Meta(ge=0, lt=1)] = 0.0

    def __post_init__(self) -> None:
        """Refuse a network that looks further back than its history, and residuals without what they add to."""
        if self.network == "tcn" and self.receptive_field > self.history:
            raise RequestError(
                f"kernel {self.kernel} and dilations {list(self.dilations)} look back {self.receptive_field} columns, "
                f"the history has {self.history}: zero padding would enter and streaming be wrong. Take fewer or "
                "smaller dilations, or a longer history."
            )
        if self.outputs == "wrench" and self.base == "none":
            raise RequestError("outputs 'wrench' are residual force and torque: give a base, nominal or grey_box.")
        if self.network == "none" and self.base == "none":
            raise RequestError("a model without a network needs a base, nominal or grey_box.")

    @property
    def receptive_field(self) -> int:
        """Columns that an output depends on, the newest included."""
        if self.network == "tcn":
            return 1 + (self.kernel - 1) * sum(self.dilations)
        return self.history if self.network == "mlp" else 1

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of a column's entries, in order: velocity m/s, attitude, rates and rotor speeds rad/s."""
        return (*STATE_INPUTS[self.inputs], *(f"motor_{rotor}" for rotor in range(self.rotors)))

    @property
    def state_inputs(self) -> int:
        """How many entries of a column, the first ones, are of the measured state; the others are rotor speeds."""
        return len(STATE_INPUTS[self.inputs])

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the six outputs: m/s^2 and rad/s^2, or N and N m."""
        return (*OUTPUTS[self.outputs], *(TORQUE if self.outputs == "wrench" else ANGULAR))


def physical_config(kind: str, *, rotors: int, like: ModelConfig | None = None) -> ModelConfig:
    """The definition of a vehicle file's model with its effects, without a network.

    like: whose rotor speeds, label, filters and time step it has; the defaults without one.
    """
    config = ModelConfig(kind, "none", base="grey_box", rotors=rotors, history=1)
    if like is None:
        return config
    return msgspec.structs.replace(
        config, motors=like.motors, label=like.label, filtered_inputs=like.filtered_inputs, dt=like.dt
    )


def convolutions_for(history: int) -> tuple[int, tuple[int, ...]]:
    """Kernel and dilations of four layers that look back at most `history` columns, as far as possible.

    Raises RequestError for a history below 1.
    """
    if history < 1:
        raise RequestError(f"a history of {history} columns: required is 1 or more.")
    if history >= 19:
        return 3, (1, 2, 2, 4)
    if history >= 9:
        return 3, (1, 1, 1, 1)
    return (2, (1,) * min(4, history - 1)) if history >= 2 else (1, (1, 1, 1, 1))
