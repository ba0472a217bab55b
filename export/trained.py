"""A checkpoint or a vehicle file as a model to export: network, physical model, source."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

from dynamics.arrays import Floats
from dynamics.errors import RequestError
from dynamics.model import Model, build_model
from dynamics.own_effects import catalogue_of
from dynamics.trust import require_approved
from dynamics.vehicle import EffectUse, Vehicle
from dynamics.vehicle_file import effect_files_in, no_such_vehicle, parse_vehicle, vehicle_text
from export.integrator import choose_integrator
from export.network import Convolution, Dense, Ensemble, Network
from runtime.control.bundle import Integrator
from training.checkpoint import TrainedModel, load
from training.config import ModelConfig, physical_config
from training.data.features import body_inertia
from training.prediction import MIN_DISAGREEMENT, disagreement_of, gate_of


@dataclass(frozen=True, eq=False)
class ExportedModel:
    """A model to export.

    config: its definition.
    network: None for a physical model.
    physics: the model that the network is added to, None for a network alone.
    vehicle, vehicle_text: the vehicle file.
    integrator: of its kernel.
    trained: the checkpoint, None for a vehicle file.
    member: of the ensemble.
    ensemble: its other members, None without any.
    source: sha256 of the file that it was read from.
    """

    config: ModelConfig
    network: Network | None
    physics: Model | None
    vehicle: Vehicle
    vehicle_text: str
    integrator: Integrator
    trained: TrainedModel | None = None
    member: int = 0
    source: str = ""
    ensemble: Ensemble | None = None

    @property
    def moment(self) -> Floats | None:
        """(n + 1, n + 1) of the inputs of the network's last layer (`training.last_layer`); None where unknown."""
        if self.trained is None or not self.trained.moments or self.integrator == "rk4":
            return None
        return self.trained.moments[self.member]

    @property
    def mean(self) -> bool:
        """Whether accelerations are means over the time to the next column, else those at the newest one."""
        return self.config.label == "mean_increment"

    @property
    def history(self) -> int:
        """Columns of a window."""
        return 1 if self.network is None else self.network.history

    @property
    def extrapolated(self) -> bool:
        """Whether the kernel extrapolates accelerations along their slope."""
        return self.integrator == "adams_bashforth"

    @property
    def window(self) -> int:
        """Columns that a prediction needs: a window, and the column before it for the slope of an extrapolated one."""
        return self.history + self.extrapolated

    @property
    def flight_model(self) -> Model:
        """The model whose states, parameters and vehicle the solver has."""
        return build_model(self.vehicle, effects=()) if self.physics is None else self.physics

    @property
    def hidden_count(self) -> int:
        """Hidden states of the physics."""
        return 0 if self.physics is None else self.physics.hidden_count


def read_model(
    path: Path, *, member: int = 0, integrator: Integrator | None = None, effect_files: Sequence[str | Path] = ()
) -> ExportedModel:
    """A vehicle file (TOML) as a physical model with its effects, or a checkpoint of training.

    integrator: None for the one that fits the model. effect_files: beside those that a vehicle file names.

    Raises RequestError when it cannot be read, has no such member, or cannot be evaluated column by column or
    integrated so.
    """
    if path.suffix == ".toml":
        text = vehicle_text(path, effect_files=effect_files)
        require_approved(effect_files_in(text), carrier=path)
        vehicle = parse_vehicle(text)
        config = physical_config("physics", rotors=vehicle.rotors.count)
        settled = choose_integrator(config, integrator)
        source = hashlib.sha256(text.encode()).hexdigest()
        return ExportedModel(config, None, build_model(vehicle), vehicle, text, settled, source=source)
    if path.suffix != ".pt" and not path.exists():
        raise RequestError(no_such_vehicle(path))
    trained = load(path)
    if trained.networks and not 0 <= member < len(trained.networks):
        raise RequestError(f"{path} has {len(trained.networks)} members, numbered from 0; there is no {member}.")
    model = exported(trained, member=member, integrator=integrator)
    return replace(model, source=hashlib.sha256(path.read_bytes()).hexdigest())


def exported(trained: TrainedModel, *, member: int = 0, integrator: Integrator | None = None) -> ExportedModel:
    """A trained model to export.

    Raises RequestError for weights that are not finite, or an integrator that does not fit.
    """
    config = trained.config
    settled = choose_integrator(config, integrator)
    physics = None if config.base == "none" else build_model(trained.vehicle, effects=_effects(trained))
    network = network_of(trained, trained.networks[member]) if trained.networks else None
    return ExportedModel(
        config,
        network,
        physics,
        trained.vehicle,
        trained.vehicle_text,
        settled,
        trained,
        member,
        ensemble=ensemble_of(trained, member) if settled != "rk4" else None,
    )


def ensemble_of(trained: TrainedModel, member: int) -> Ensemble | None:
    """The other members, and from when on a grey box's residual fades; None where one network was trained alone."""
    if trained.reliability is None:
        return None
    others = [network for place, network in enumerate(trained.networks) if place != member]
    return Ensemble(
        tuple(network_of(trained, network) for network in others),
        max(trained.reliability.disagreement, MIN_DISAGREEMENT),
        trained.config.base == "grey_box",
    )


def _effects(trained: TrainedModel) -> list[EffectUse]:
    """The effects of the physics under a model, as training had them (`training.physics.RowModel`)."""
    if trained.config.base == "nominal":
        return []
    measured, catalogue = trained.config.motors == "measured", catalogue_of(trained.vehicle)
    return [use for use in trained.vehicle.effects if not (measured and catalogue[use.name].rotor_speed)]


def network_of(trained: TrainedModel, module: nn.Module) -> Network:
    """A member's numbers in SI units, its batch norm folded into the layers that follow, which no padding disturbs."""
    config, scaling = trained.config, trained.scaling
    weights = {name: value.double().numpy() for name, value in module.state_dict().items()}
    entries = len(config.input_names)
    if config.network == "tcn":
        convolutions, folded = _convolutions(weights, config)
        perceptron = _perceptron(weights, "decoder.", folded)
    elif config.history > 1:
        first, *rest = _perceptron(weights, "decoder.", None)
        window = first.weight.reshape(-1, config.history, entries).transpose(0, 2, 1)
        convolutions, perceptron = (Convolution(window, first.bias, 1),), tuple(rest)
    else:
        convolutions, perceptron = (), _perceptron(weights, "decoder.", None)
    share = 1 / body_inertia(trained.vehicle) if config.outputs == "wrench" else np.ones(6)
    return Network(
        convolutions,
        perceptron,
        scaling.input_mean,
        scaling.input_std,
        scaling.output_mean * share,
        scaling.output_std * share,
        config.inputs,
        "world" if config.outputs == "world" else "body",
        config.base != "none",
        config.rotors,
        config.dt,
        config.history,
    )


def _convolutions(
    weights: dict[str, Floats], config: ModelConfig
) -> tuple[tuple[Convolution, ...], tuple[Floats, ...]]:
    """The convolutions, and factor and shift of the last one's batch norm, which the perceptron takes in."""
    convolutions = []
    factor, shift = np.ones(len(config.input_names)), np.zeros(len(config.input_names))
    for i, dilation in enumerate(config.dilations):
        flat, bias = weights[f"layers.{i}.linear.weight"], weights[f"layers.{i}.linear.bias"]
        weight = flat.reshape(len(flat), config.kernel, -1).transpose(0, 2, 1)
        convolutions.append(
            Convolution(weight * factor[:, None], bias + np.einsum("oik,i->o", weight, shift), dilation)
        )
        factor, shift = np.ones(len(flat)), np.zeros(len(flat))
        if config.batch_norm:
            norm = {
                name: weights[f"layers.{i}.norm.{name}"] for name in ("weight", "bias", "running_mean", "running_var")
            }
            factor = norm["weight"] / np.sqrt(norm["running_var"] + nn.BatchNorm1d(1).eps)
            shift = norm["bias"] - norm["running_mean"] * factor
    return tuple(convolutions), (factor, shift)


def _perceptron(weights: dict[str, Floats], prefix: str, norm: tuple[Floats, ...] | None) -> tuple[Dense, ...]:
    places = sorted({int(name[len(prefix) :].split(".")[0]) for name in weights if name.startswith(prefix)})
    layers = [Dense(weights[f"{prefix}{i}.weight"], weights[f"{prefix}{i}.bias"]) for i in places]
    if norm is not None:
        first, (factor, shift) = layers[0], norm
        layers[0] = Dense(first.weight * factor, first.bias + first.weight @ shift)
    return tuple(layers)


def torch_forward(model: ExportedModel, inputs: Floats, *, double: bool) -> Floats:
    """Outputs (m, 6) of the member itself, as torch evaluates it and training fades it, for windows (m, T, inputs).

    double: evaluated in doubles.
    """
    assert model.trained is not None
    scaling = model.trained.scaling
    own = _evaluated(model.trained, model.member, inputs, double=double)
    if model.ensemble is None or not model.ensemble.fades:
        return own
    others = [place for place in range(len(model.trained.networks)) if place != model.member]
    outputs = np.stack([own, *(_evaluated(model.trained, place, inputs, double=double) for place in others)])
    disagreement = disagreement_of(outputs, scaling.output_std)
    return np.asarray(gate_of(disagreement, model.ensemble.limit)[:, None] * own)


def _evaluated(trained: TrainedModel, member: int, inputs: Floats, *, double: bool) -> Floats:
    """Outputs (m, 6) of a member for windows (m, T, inputs)."""
    scaling, kind = trained.scaling, torch.float64 if double else torch.float32
    module = trained.networks[member].to(kind)
    standardised = torch.as_tensor((inputs - scaling.input_mean) / scaling.input_std, dtype=kind)
    with torch.no_grad():
        outputs = module(standardised).double().numpy()
    module.to(torch.float32)
    return np.asarray(outputs * scaling.output_std + scaling.output_mean)
