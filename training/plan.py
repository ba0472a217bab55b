"""The plan of a training: data, scaling and collocation points that all members share, and the assembled model."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import msgspec
import numpy as np
import torch

from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import vehicle_toml
from training.card import Card
from training.checkpoint import Ranges, Scaling, TrainedModel
from training.config import ModelConfig
from training.data.collocation import CollocationPoints, collocation_points
from training.data.labelled_rows import LabelledRows, label_rows, with_logged_motors
from training.data.logged_flights import Split
from training.data.tensors import CollocationTensors, Tensors, make_scaling
from training.effects_fit import fit_effects, with_rotor_lag
from training.last_layer import feature_moments
from training.networks import build_network
from training.prediction import flight_errors, judge_reliability, member_outputs, predict
from training.recipe import Recipe
from training.rollout_loss import RolloutLoss
from training.trainer import Member, Task

MIN_VALIDATION = 50  # windows
LIBRARIES = ("torch", "numpy", "casadi", "scipy")


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that the members of an ensemble share. vehicle: with its effects fitted, where they are of use."""

    config: ModelConfig
    recipe: Recipe
    vehicle: Vehicle
    split: Split
    training: LabelledRows
    validation: LabelledRows
    scaling: Scaling
    collocation: CollocationPoints | None
    fingerprint: str

    def task(self, member: int, seed: int, *, device: torch.device, state_file: Path | None) -> Task:
        """Task of one member. Raises DataError when no segment is long enough for its roll-outs."""
        training = Tensors.of(self.training, self.scaling, self.config.history, device)
        collocation = (
            None if self.collocation is None else CollocationTensors.of(self.collocation, self.scaling, device)
        )
        rollout = None
        if self.recipe.rollout > 1:
            rollout = RolloutLoss.of(
                self.config,
                self.vehicle,
                self.training,
                training,
                self.scaling,
                self.recipe.rollout,
                self.recipe.input_noise,
            )
        return Task(
            config=self.config,
            recipe=self.recipe,
            training=training,
            validation=Tensors.of(self.validation, self.scaling, self.config.history, device),
            collocation=collocation,
            rollout=rollout,
            rows=self.training.names,
            fingerprint=self.fingerprint,
            member=member,
            seed=seed,
            state_file=state_file,
        )

    def assemble(self, members: Sequence[Member], seeds: Sequence[int], *, command: str) -> TrainedModel:
        """The model of the trained members, judged on the validation flights."""
        networks = []
        for member in members:
            network = build_network(self.config)
            network.load_state_dict(member.weights)
            networks.append(network.cpu().eval().requires_grad_(requires_grad=False))
        inputs = self.training.inputs[self.training.ends]
        ranges = Ranges(inputs.min(axis=0), inputs.max(axis=0))
        text = vehicle_toml(self.vehicle)
        card = self._card(command, text, ranges)
        model = TrainedModel(self.config, tuple(networks), self.scaling, ranges, self.vehicle, text, card)
        if networks:
            outputs = member_outputs(model, self.validation)
            targets = self.validation.targets[self.validation.ends]
            judged = judge_reliability(outputs, targets, self.scaling.output_std)
            model = dataclasses.replace(model, reliability=judged, moments=feature_moments(model, self.training))
        card = msgspec.structs.replace(
            card,
            seeds=tuple(seeds[: len(members)]),
            steps=tuple(member.steps for member in members),
            best_step=tuple(member.best_step for member in members),
            seconds=tuple(round(member.seconds, 1) for member in members),
            parameters=sum(weight.numel() for weight in networks[0].parameters()) if networks else 0,
            errors=flight_errors(self.validation, predict(model, self.validation).body),
        )
        return dataclasses.replace(model, card=card)

    def _card(self, command: str, vehicle_text: str, ranges: Ranges) -> Card:
        limits = zip(ranges.lowest.tolist(), ranges.highest.tolist(), strict=True)
        return Card(
            kind=self.config.kind,
            command=command,
            date=datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
            recipe=self.recipe,
            flights={recording.name: recording.sha256 for recording in self.split.training},
            validation={recording.name: recording.sha256 for recording in self.split.validation},
            vehicle=self.vehicle.name,
            vehicle_sha256=hashlib.sha256(vehicle_text.encode()).hexdigest(),
            rows=len(self.training.ends),
            ranges=dict(zip(self.config.input_names, limits, strict=True)),
            versions={name: metadata.version(name) for name in ("alula", *LIBRARIES)},
            notes=self.split.notes,
        )


def make_plan(
    config: ModelConfig, recipe: Recipe, vehicle: Vehicle, split: Split, *, seed: int, fit: bool = True
) -> Plan:
    """The plan for flights that are already read.

    seed: of the collocation points.
    fit: whether a vehicle file's effects are fitted to the training flights, for a model that uses them: a grey box,
        and one whose collocation points are pulses.

    Raises RequestError for options that contradict each other, DataError for flights that cannot be learned from.
    """
    _require_consistent(config, recipe)
    everything = (*split.training, *split.validation)
    config = with_logged_motors(msgspec.structs.replace(config, rotors=vehicle.rotors.count), everything, vehicle)
    training = label_rows(config, vehicle, split.training)
    pulses = recipe.physics_weight > 0 and recipe.physics_points == "pulses"
    if fit and (config.base == "grey_box" or (pulses and vehicle.effects)):
        vehicle = fit_effects(config, vehicle, training)
        if config.base == "grey_box":
            training = label_rows(config, vehicle, split.training)
    validation = label_rows(config, vehicle, split.validation, min_windows=MIN_VALIDATION)
    scaling = make_scaling(config, recipe, vehicle, training)
    collocation = None
    if recipe.physics_weight > 0:
        lags = fit and pulses and config.base != "grey_box"
        responding = with_rotor_lag(config, vehicle, training) if lags else vehicle
        collocation = collocation_points(config, recipe, responding, training, seed=seed)
    digest = hashlib.sha256(msgspec.json.encode([config, recipe, str(torch.__version__)]))
    collocated = () if collocation is None else (collocation.windows, collocation.targets)
    for values in (training.inputs, training.targets, training.ends, validation.inputs, validation.ends, *collocated):
        digest.update(np.ascontiguousarray(values).tobytes())
    return Plan(config, recipe, vehicle, split, training, validation, scaling, collocation, digest.hexdigest())


def _require_consistent(config: ModelConfig, recipe: Recipe) -> None:
    if recipe.physics_weight > 0 and config.base != "none" and recipe.physics_points != "pulses":
        raise RequestError(
            f"the physics-inspired loss on {recipe.physics_points} is for models without a base, {config.kind} has "
            "one. Give --physics-weight 0 or --physics-points pulses."
        )
    if recipe.rollout > 1 and (recipe.physics_weight > 0 or config.batch_norm or config.filtered_inputs):
        raise RequestError(
            "roll-outs are for causal inputs, without batch norm and the physics-inspired loss. Give "
            "--physics-weight 0 and another recipe than paper."
        )
