"""Models on flights that none of them has seen: the figures of the paper's Table I, and what they do not show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from dynamics.state import ATTITUDE
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import vehicle_toml
from training.calibration import Calibration, calibration
from training.card import Card, FlightError
from training.checkpoint import Ranges, Scaling, TrainedModel
from training.config import ModelConfig
from training.data.dataset import Dataset, make_dataset, settled_motors
from training.data.features import world_accelerations
from training.data.recordings import Recording
from training.ground_truth import hidden_plant, true_label, true_states
from training.open_loop import OpenLoop, Pulse, open_loop, pulse_responses
from training.prediction import flight_errors, pooled, predict
from training.recipe import FAST

FEWEST = 50  # windows
NOMINAL, PLANT = "NOM", "plant"
BASE = "named effects alone"


class Peak(msgspec.Struct, frozen=True):
    """Highest accelerations of a flight: m/s^2 without gravity, rad/s^2; of the truth where it is known."""

    flight: str
    linear: float
    angular: float


class Evaluation(msgspec.Struct, frozen=True):
    """One model. label, true: errors by flight against labels, and against a campaign's truth where there is one.

    members: RMSE of each member by itself, all flights and components, against the truth or else the labels.
    """

    name: str
    kind: str
    history: int
    motors: str
    filtered_inputs: bool
    label: tuple[FlightError, ...]
    true: tuple[FlightError, ...] = ()
    members: tuple[float, ...] = ()
    open_loop: tuple[OpenLoop, ...] = ()
    pulses: tuple[Pulse, ...] = ()
    calibration: Calibration | None = None

    @property
    def best_known(self) -> tuple[FlightError, ...]:
        """Errors against the truth, or against labels where that is all there is."""
        return self.true or self.label


class Evaluated(msgspec.Struct, frozen=True):
    """All models on the same flights. flights: sha256 by name. notes: what a reader has to know."""

    models: tuple[Evaluation, ...]
    peaks: tuple[Peak, ...]
    flights: dict[str, str]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Judged:
    """What pictures and clocks need: rows, and what the model says at their `ends`, body accelerations (m, 6)."""

    evaluation: Evaluation
    model: TrainedModel
    data: Dataset
    body: Floats


@dataclass(frozen=True)
class Named:
    """A model under the name that tables show."""

    name: str
    model: TrainedModel


def evaluate(
    models: Sequence[Named], recordings: Sequence[Recording], *, campaign: Path | None, done: Callable[[str], None]
) -> tuple[Evaluated, tuple[Judged, ...]]:
    """Every model, NOM of the first one's vehicle before them, the plant behind them where a campaign tells it.

    Before a grey box with a network stands its base, so that what the network adds can be seen. done: told each name
    when its model is through. Raises RequestError for flights that a model has learned from, DataError for flights that
    cannot be judged on.
    """
    if not models:
        raise RequestError("no model to evaluate. Give checkpoints of `alula train` (.pt), or --vehicle.")
    vehicle, config = models[0].model.vehicle, models[0].model.config
    notes = [note for named in models for note in _seen_before(named, recordings)]
    plant = None if campaign is None else physical_model(PLANT, hidden_plant(campaign, vehicle), config)
    bare = msgspec.structs.replace(vehicle, effects=())
    everyone = [Named(NOMINAL, physical_model("nominal", bare, config))]
    for named in models:
        everyone += [*_base_of(named), named]
    if plant is not None:
        everyone.append(Named(PLANT, plant))
    judged = []
    for named in everyone:
        judged.append(_judge(named, recordings, campaign, plant))
        done(named.name)
    flights = {recording.name: recording.sha256 for recording in recordings}
    found = Evaluated(
        tuple(j.evaluation for j in judged), _peaks(judged[0].data, campaign, config.dt), flights, tuple(notes)
    )
    return found, tuple(judged)


def physical_model(kind: str, vehicle: Vehicle, like: ModelConfig) -> TrainedModel:
    """A vehicle file's model with its effects, on the same inputs and labels as another model, to stand beside it."""
    config = ModelConfig(
        kind, "none", base="grey_box", motors=like.motors, label=like.label, filtered_inputs=like.filtered_inputs,
        rotors=like.rotors, dt=like.dt, history=1,
    )  # fmt: skip
    inputs = len(config.input_names)
    card = Card(kind, "", "", FAST, {}, {}, vehicle.name, "")
    return TrainedModel(
        config, (), Scaling(np.zeros(inputs), np.ones(inputs), np.zeros(6), np.ones(6)),
        Ranges(np.full(inputs, -np.inf), np.full(inputs, np.inf)), vehicle, vehicle_toml(vehicle), card,
    )  # fmt: skip


def seen_by(model: TrainedModel, recordings: Sequence[Recording]) -> Dataset:
    """The flights as the model takes them. Raises DataError when they lack the motors that it was trained on."""
    settled = settled_motors(model.config, recordings, model.vehicle)
    if settled.motors != model.config.motors:
        raise DataError(
            f"the model takes {model.config.motors} rotor speeds, these flights have only the other kind. Give flights "
            f"that log them, or train with --motors {settled.motors}."
        )
    return make_dataset(model.config, model.vehicle, recordings, fewest=FEWEST)


def _seen_before(named: Named, recordings: Sequence[Recording]) -> list[str]:
    """Notes on flights that chose a model's best step. Raises RequestError for those that it was trained on."""
    card = named.model.card
    learned = [r.name for r in recordings if r.sha256 in card.flights.values()]
    if learned:
        raise RequestError(
            f"{named.name} was trained on {', '.join(learned[:4])}: errors there say nothing. Give other flights."
        )
    chosen = [r.name for r in recordings if r.sha256 in card.validation.values()]
    return [f"the best step of {named.name} was chosen on {', '.join(chosen)}"] if chosen else []


def _base_of(named: Named) -> list[Named]:
    model = named.model
    if not model.networks or model.config.base != "grey_box":
        return []
    return [Named(f"{named.name} base", physical_model(BASE, model.vehicle, model.config))]


def _judge(named: Named, recordings: Sequence[Recording], campaign: Path | None, plant: TrainedModel | None) -> Judged:
    model, config = named.model, named.model.config
    data = seen_by(model, recordings)
    body = predict(model, data).body
    truth = None if campaign is None else true_label(data, campaign, dt=config.dt)
    states = data.state if campaign is None else true_states(data, campaign, dt=config.dt)
    best = data.label if truth is None else truth
    members = tuple(
        pooled(flight_errors(data, predict(model, data, member=place).body, best)).combined
        for place in range(len(model.networks))
    )
    found = Evaluation(
        named.name, config.kind, config.history, config.motors, config.filtered_inputs,
        label=flight_errors(data, body),
        true=() if truth is None else flight_errors(data, body, truth),
        members=members,
        open_loop=open_loop(model, data, states),
        pulses=() if plant is None else pulse_responses(model, plant, data),
        calibration=calibration(model, data, best),
    )  # fmt: skip
    return Judged(found, model, data, body)


def _peaks(data: Dataset, campaign: Path | None, dt: float) -> tuple[Peak, ...]:
    label = data.label if campaign is None else true_label(data, campaign, dt=dt)
    world = world_accelerations(label, data.state[:, ATTITUDE])
    known = np.isfinite(world).all(axis=1)
    found = []
    for place, name in enumerate(data.flights):
        rows = world[known & (data.flight_of == place)]
        linear, angular = (float(np.linalg.norm(part, axis=1).max(initial=0.0)) for part in (rows[:, :3], rows[:, 3:]))
        found.append(Peak(name, linear, angular))
    return tuple(found)
