"""A trained model as one file: config, weights of every member, scaling, ranges, vehicle file, card.

The file is what `torch.save` makes of plain dictionaries and tensors, so that reading it runs no code of it:

    format, version   "alula model", 2
    config            ModelConfig as a dictionary
    members           one state_dict a member of the ensemble, empty for models that are only evaluated
    scaling           input_mean, input_std (inputs,), output_mean, output_std (6,)
    ranges            lowest, highest (inputs,) of the training flights, in the inputs' units
    reliability       disagreement, error_floor (6,), error_scale (6,), or none for a single member
    moments           of each member, (n + 1, n + 1) of its last layer's n inputs and 1 (`training.last_layer`); absent
                      in files of older versions, whose last layer cannot follow in flight
    vehicle           TOML text, with the texts of effects of the user's own, which run only where he approved them
    card              JSON text

Inputs are in SI units. Version 1 had rotor speeds in thousands of rpm; such a file is converted when it is read.
"""

from __future__ import annotations

import os
import pickle
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from torch import Tensor, nn

from dynamics.arrays import Floats
from dynamics.decoding import decode_json
from dynamics.effect_source import as_carried
from dynamics.errors import RequestError
from dynamics.field_errors import described
from dynamics.trust import require_approved
from dynamics.units import RPM
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import effect_files_in, parse_vehicle, with_texts
from training.card import Card
from training.config import ModelConfig
from training.foreign_network import ONLY_OURS, is_state_dict, kind_of_file
from training.networks import build_network

FORMAT, VERSION = "alula model", 2
IN_KILO_RPM = 1  # the version whose rotor speeds were in thousands of rpm
REPLACE_IT = "Restore it from an intact copy, or train it again."


@dataclass(frozen=True, eq=False)
class Scaling:
    """standardised = (value - mean) / std. input_*: (inputs,), output_*: (6,)."""

    input_mean: Floats
    input_std: Floats
    output_mean: Floats
    output_std: Floats


@dataclass(frozen=True, eq=False)
class Ranges:
    """Lowest and highest value (inputs,) of each input in training, in its unit."""

    lowest: Floats
    highest: Floats


@dataclass(frozen=True, eq=False)
class Reliability:
    """Relation of an ensemble's disagreement to its error, from the validation flights.

    disagreement: RMS over the outputs of the members' standardised deviation that 1 row in 100 exceeds.
    error_floor, error_scale: (6,) half the width of a 90 % interval is the root of
        floor^2 + (scale * the members' deviation)^2.
    """

    disagreement: float
    error_floor: Floats
    error_scale: Floats


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """A model ready to predict.

    networks: members in evaluation mode, none for a base alone.
    vehicle_text: the vehicle file.
    reliability: of an ensemble, None for a single network.
    moments: of the members' last layers (`training.last_layer`), empty for a file of an older version.
    """

    config: ModelConfig
    networks: tuple[nn.Module, ...]
    scaling: Scaling
    ranges: Ranges
    vehicle: Vehicle
    vehicle_text: str
    card: Card
    reliability: Reliability | None = None
    moments: tuple[Floats, ...] = ()

    def outputs(self, windows: Floats | Tensor, *, member: int | None = None) -> Floats:
        """Outputs (members, m, 6) of the members for windows (m, T, inputs), both in their units.

        member: that one only, (1, m, 6).
        """
        scaling = self.scaling
        chosen = self.networks if member is None else (self.networks[member],)
        raw = torch.as_tensor(windows, dtype=torch.float64)
        standardised = ((raw - torch.from_numpy(scaling.input_mean)) / torch.from_numpy(scaling.input_std)).float()
        with torch.no_grad():
            outputs = torch.stack([network(standardised) for network in chosen]).double().numpy()
        return np.asarray(outputs * scaling.output_std + scaling.output_mean)


def save(model: TrainedModel, path: Path) -> None:
    """Write a checkpoint under a temporary name, then rename it. Raises RequestError when it cannot be written."""
    scaling, ranges, reliability = model.scaling, model.ranges, model.reliability
    content = {
        "format": FORMAT,
        "version": VERSION,
        "config": msgspec.to_builtins(model.config),
        "members": [{name: value.cpu() for name, value in net.state_dict().items()} for net in model.networks],
        "scaling": {name: torch.from_numpy(getattr(scaling, name)) for name in Scaling.__dataclass_fields__},
        "ranges": {"lowest": torch.from_numpy(ranges.lowest), "highest": torch.from_numpy(ranges.highest)},
        "reliability": None
        if reliability is None
        else {
            "disagreement": reliability.disagreement,
            "error_floor": torch.from_numpy(reliability.error_floor),
            "error_scale": torch.from_numpy(reliability.error_scale),
        },
        "moments": [torch.from_numpy(moment) for moment in model.moments],
        "vehicle": model.vehicle_text,
        "card": msgspec.json.encode(model.card).decode(),
    }
    write_atomically(content, path)


def write_atomically(content: dict[str, Any], path: Path) -> None:
    """`torch.save` under a temporary name, then rename. Raises RequestError when the disk refuses."""
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("wb") as file:
            torch.save(content, file)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except (OSError, RuntimeError) as error:  # torch reports a full disk as a RuntimeError
        part.unlink(missing_ok=True)
        raise RequestError(f"cannot write {path}: {error}. Free some space or give another --out.") from error


def read_content(path: Path) -> dict[str, Any]:
    """The dictionary that `torch.save` wrote. Raises RequestError for a file that is missing or cannot be read so."""
    if foreign := kind_of_file(path):
        raise RequestError(f"{path} is {foreign} of another tool. {ONLY_OURS}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # about pickles, which are refused below
            content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise RequestError(f"there is no {path}. Give a model that `alula train` wrote.") from error
    except OSError as error:
        raise RequestError(
            f"{path} is no checkpoint, or a damaged one: {error.strerror or error}. {REPLACE_IT}"
        ) from error
    except (
        RuntimeError,
        EOFError,
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        pickle.UnpicklingError,
    ) as error:
        # torch's message advises weights_only=False, which runs the file's code
        raise RequestError(f"{path} is no checkpoint, or a damaged one: torch cannot read it. {REPLACE_IT}") from error
    if not isinstance(content, dict):
        raise RequestError(f"{path} is no checkpoint of alula: it holds a {type(content).__name__}.")
    return content


def load(path: str | Path) -> TrainedModel:
    """A checkpoint, every member in evaluation mode.

    Raises RequestError for a file that is missing, damaged, of another version, whose weights have another shape
    than that of its config, or whose vehicle has effects that the user has not approved.
    """
    path = Path(path)
    content = read_content(path)
    if is_state_dict(content):
        raise RequestError(f"{path} holds the weights of a torch module alone. {ONLY_OURS}")
    if content.get("format") != FORMAT:
        raise RequestError(
            f"{path} is no model of alula: its format is {content.get('format')!r}, required is {FORMAT!r}."
        )
    if content.get("version") not in (IN_KILO_RPM, VERSION):
        raise RequestError(
            f"{path} is a model of version {content.get('version')}, this alula reads up to {VERSION}: train it again, "
            "or read it with the alula that wrote it."
        )
    if isinstance(text := content.get("vehicle"), str):
        content["vehicle"] = _approved_vehicle_text(text, path)
    try:
        model = _model(content)
        return model if content["version"] == VERSION else _in_si(model)
    except (LookupError, TypeError, AttributeError, ValueError, RuntimeError, msgspec.MsgspecError) as error:
        raise RequestError(
            f"{path} is a damaged model: {type(error).__name__}: {_first_line(error)}. {REPLACE_IT}"
        ) from error
    except RequestError as error:
        raise RequestError(f"{path} is a damaged model: {error} {REPLACE_IT}") from error


def _approved_vehicle_text(text: str, path: Path) -> str:
    """A vehicle's text with the texts of its effect files, which are data. Raises RequestError where not approved."""
    files = as_carried(effect_files_in(text))
    if not files:
        return text
    require_approved(files, carrier=path)
    return with_texts(text, files)


def _model(content: dict[str, Any]) -> TrainedModel:
    """The model of a checkpoint's entries. Raises RequestError, and what conversions raise, for invalid ones."""
    config = msgspec.convert(content["config"], ModelConfig)
    card = decode_json(content["card"], Card)
    scaling = Scaling(**{name: value.double().numpy() for name, value in content["scaling"].items()})
    ranges = Ranges(**{name: value.double().numpy() for name, value in content["ranges"].items()})
    limits = content["reliability"]
    reliability = limits and Reliability(
        limits["disagreement"], limits["error_floor"].double().numpy(), limits["error_scale"].double().numpy()
    )
    vehicle = parse_vehicle(content["vehicle"])
    _require_widths(config, scaling, ranges, reliability)
    if not all(np.isfinite(part).all() for part in (*vars(scaling).values(), *vars(ranges).values())):
        raise RequestError("scaling or ranges that are not finite.")
    if vehicle.rotors.count != config.rotors:
        raise RequestError(f"its vehicle has {vehicle.rotors.count} rotors, its config {config.rotors}.")
    networks = _networks(config, content["members"])
    moments = tuple(moment.double().numpy() for moment in content.get("moments", ()))
    _require_moments(networks, moments)
    return TrainedModel(config, networks, scaling, ranges, vehicle, content["vehicle"], card, reliability, moments)


def _in_si(model: TrainedModel) -> TrainedModel:
    """A model of version 1 with rotor speeds, the last entries of a column, in rad/s instead of thousands of rpm."""
    unit = np.ones(len(model.config.input_names))
    unit[model.config.state_inputs :] = 1000 * RPM
    scaling, ranges, card = model.scaling, model.ranges, model.card
    factors = dict(zip(model.config.input_names, unit.tolist(), strict=True))
    limits = {name: (factors[name] * low, factors[name] * high) for name, (low, high) in card.ranges.items()}
    return replace(
        model,
        scaling=replace(scaling, input_mean=unit * scaling.input_mean, input_std=unit * scaling.input_std),
        ranges=Ranges(unit * ranges.lowest, unit * ranges.highest),
        card=msgspec.structs.replace(card, ranges=limits),
    )


def _require_widths(config: ModelConfig, scaling: Scaling, ranges: Ranges, reliability: Reliability | None) -> None:
    inputs = len(config.input_names)
    input_widths = [len(scaling.input_mean), len(scaling.input_std), len(ranges.lowest), len(ranges.highest)]
    output_widths = [len(scaling.output_mean), len(scaling.output_std)]
    if reliability is not None:
        output_widths += [len(reliability.error_floor), len(reliability.error_scale)]
    if input_widths != [inputs] * 4 or output_widths != [6] * len(output_widths):
        raise RequestError(
            f"scaling and ranges are for {input_widths[0]} inputs and {output_widths[0]} outputs, its config has "
            f"{inputs} and 6."
        )


def _require_moments(networks: Sequence[nn.Module], moments: Sequence[Floats]) -> None:
    """Raises RequestError for moments of other layers than the networks' last ones, or that no inputs have."""
    if not moments:
        return
    sizes = [list(network.state_dict().values())[-2].shape[1] + 1 for network in networks]
    if [moment.shape for moment in moments] != [(size, size) for size in sizes]:
        raise RequestError("moments of other layers than its networks' last ones.")
    if not all(np.isfinite(moment).all() for moment in moments):
        raise RequestError("moments that are not finite.")


def _networks(config: ModelConfig, members: Sequence[dict[str, Tensor]]) -> tuple[nn.Module, ...]:
    if bool(members) != (config.network != "none"):
        raise RequestError(f"it has {len(members)} networks and is a {config.kind} model.")
    networks = []
    for weights in members:
        network = build_network(config)
        try:
            network.load_state_dict(weights)
        except RuntimeError as error:
            raise RequestError(f"weights of another shape than that of its config: {_first_line(error)}.") from error
        if not all(torch.isfinite(weight).all() for weight in network.state_dict().values()):
            raise RequestError("weights that are not finite.")
        networks.append(network.eval().requires_grad_(requires_grad=False))
    return tuple(networks)


def _first_line(error: Exception) -> str:
    return " ".join(described(error).split())[:200]
