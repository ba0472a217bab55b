"""Models evaluated on flights that none of them was trained on: the numbers of the paper's Table I, and more."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from diagnosis.models.open_loop import HorizonError
from dynamics.arrays import Floats
from dynamics.errors import DataError, RequestError
from dynamics.state import ATTITUDE
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import vehicle_toml
from training.calibration import Calibration, calibration
from training.card import Card, FlightError
from training.checkpoint import Ranges, Scaling, TrainedModel
from training.config import ModelConfig, physical_config
from training.data.features import world_accelerations
from training.data.labelled_rows import LabelledRows, label_rows, with_logged_motors
from training.data.logged_flights import LoggedFlight
from training.ground_truth import hidden_plant, true_label, true_states
from training.open_loop_errors import Pulse, open_loop_errors, pulse_responses
from training.prediction import flight_errors, pooled, predict
from training.recipe import FAST

MIN_WINDOWS = 50  # windows
NOMINAL, PLANT = "NOM", "plant"
VEHICLE_FILE = "vehicle file"  # the kind of a vehicle file's own model
BASE = "named effects alone"


class Peak(msgspec.Struct, frozen=True):
    """Highest accelerations of a flight: m/s^2 without gravity, rad/s^2; of the ground truth where there is one."""

    flight: str
    linear: float
    angular: float


class Evaluation(msgspec.Struct, frozen=True):
    """Results of one model.

    label: errors by flight against labels.
    true: the same against a campaign's ground truth, empty without one.
    members: RMSE of each member by itself, over all flights and components, against ground truth or else labels.
    open_loop: errors after each horizon, empty without segments that are long enough.
    pulses: errors of the response to pulses, empty without a known plant.
    calibration: of an ensemble, None for a single network.
    """

    name: str
    kind: str
    history: int
    motors: str
    filtered_inputs: bool
    label: tuple[FlightError, ...]
    true: tuple[FlightError, ...] = ()
    members: tuple[float, ...] = ()
    open_loop: tuple[HorizonError, ...] = ()
    pulses: tuple[Pulse, ...] = ()
    calibration: Calibration | None = None

    @property
    def best_known(self) -> tuple[FlightError, ...]:
        """Errors against ground truth, or against labels without one."""
        return self.true or self.label


class EvaluationReport(msgspec.Struct, frozen=True):
    """Results of all models on the same flights.

    flights: sha256 by name.
    notes: what a reader has to know.
    """

    models: tuple[Evaluation, ...]
    peaks: tuple[Peak, ...]
    flights: dict[str, str]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class EvaluatedModel:
    """An evaluated model with its predictions, for figures and timing.

    data: the rows.
    body: (m, 6) predicted body accelerations at their `ends`.
    """

    evaluation: Evaluation
    model: TrainedModel
    data: LabelledRows
    body: Floats


@dataclass(frozen=True)
class NamedModel:
    """A model under its name in tables."""

    name: str
    model: TrainedModel


def evaluate(
    models: Sequence[NamedModel],
    recordings: Sequence[LoggedFlight],
    *,
    campaign: Path | None,
    done: Callable[[str], None],
) -> tuple[EvaluationReport, tuple[EvaluatedModel, ...]]:
    """Evaluate every model, the nominal one before them, the plant after them where a campaign names it.

    A grey box with a network follows its base, which shows what the network adds. done: called with the name of each
    model that is finished. Flights that a model was trained on are left out, with a note. Raises RequestError where no
    other flight was given, DataError for flights that models cannot be evaluated on.
    """
    if not models:
        raise RequestError("no model to evaluate. Give checkpoints of `alula train` (.pt), or --vehicle.")
    vehicle, config = models[0].model.vehicle, models[0].model.config
    recordings, notes = _unlearned(models, recordings)
    notes += [note for named in models for note in _validation_notes(named, recordings)]
    plant = None if campaign is None else physical_model(PLANT, hidden_plant(campaign, vehicle), config)
    bare = msgspec.structs.replace(vehicle, effects=())
    everyone = [NamedModel(NOMINAL, physical_model("nominal", bare, config))]
    for named in models:
        everyone += [*_base_of(named), named]
    if plant is not None:
        everyone.append(NamedModel(PLANT, plant))
    evaluated = []
    for named in everyone:
        evaluated.append(_evaluated(named, recordings, campaign, plant))
        done(named.name)
    flights = {recording.name: recording.sha256 for recording in recordings}
    peaks = _peaks(evaluated[0].data, campaign, config.dt)
    report = EvaluationReport(tuple(one.evaluation for one in evaluated), peaks, flights, tuple(notes))
    return report, tuple(evaluated)


def physical_model(kind: str, vehicle: Vehicle, like: ModelConfig) -> TrainedModel:
    """A vehicle file's model with its effects, on the same inputs and labels as another model."""
    config = physical_config(kind, rotors=like.rotors, like=like)
    inputs = len(config.input_names)
    card = Card(kind, "", "", FAST, {}, {}, vehicle.name, "")
    return TrainedModel(
        config,
        (),
        Scaling(np.zeros(inputs), np.ones(inputs), np.zeros(6), np.ones(6)),
        Ranges(np.full(inputs, -np.inf), np.full(inputs, np.inf)),
        vehicle,
        vehicle_toml(vehicle),
        card,
    )


def rows_for(model: TrainedModel, recordings: Sequence[LoggedFlight]) -> LabelledRows:
    """The flights as the model takes them. Raises DataError when they lack the rotor speeds that it was trained on."""
    logged = with_logged_motors(model.config, recordings, model.vehicle)
    if logged.motors != model.config.motors:
        raise DataError(
            f"the model takes {model.config.motors} rotor speeds, these flights have only the other kind. Give flights "
            f"that log them, or train with --motors {logged.motors}."
        )
    return label_rows(model.config, model.vehicle, recordings, min_windows=MIN_WINDOWS)


def _unlearned(
    models: Sequence[NamedModel], recordings: Sequence[LoggedFlight]
) -> tuple[tuple[LoggedFlight, ...], list[str]]:
    """The flights that no model was trained on, the same for all, and a note on the others.

    Raises RequestError where none is left.
    """
    learned: dict[str, list[str]] = {}
    for named in models:
        for recording in recordings:
            if recording.sha256 in named.model.card.flights.values():
                learned.setdefault(recording.name, []).append(named.name)
    left = tuple(recording for recording in recordings if recording.name not in learned)
    trained = list(dict.fromkeys(name for names in learned.values() for name in names))
    if not left:
        raise RequestError(
            f"{' and '.join(trained)} {'was' if len(trained) == 1 else 'were'} trained on {_few(learned)}: errors "
            "there mean nothing, and no other flight was given. Give others."
        )
    note = f"left out, since {' and '.join(trained)} learned from them: {_few(learned)}"
    return left, [note] if learned else []


def _few(names: Iterable[str], shown: int = 4) -> str:
    """Some names, the first ones of many."""
    listed = list(names)
    return ", ".join(listed[:shown]) + (f" and {len(listed) - shown} more" if len(listed) > shown else "")


def _validation_notes(named: NamedModel, recordings: Sequence[LoggedFlight]) -> list[str]:
    """Notes on flights that chose a model's best step."""
    chosen = [r.name for r in recordings if r.sha256 in named.model.card.validation.values()]
    return [f"the best step of {named.name} was chosen on {', '.join(chosen)}"] if chosen else []


def _base_of(named: NamedModel) -> list[NamedModel]:
    model = named.model
    if not model.networks or model.config.base != "grey_box":
        return []
    return [NamedModel(f"{named.name} base", physical_model(BASE, model.vehicle, model.config))]


def _evaluated(
    named: NamedModel, recordings: Sequence[LoggedFlight], campaign: Path | None, plant: TrainedModel | None
) -> EvaluatedModel:
    model, config = named.model, named.model.config
    data = rows_for(model, recordings)
    body = predict(model, data).body
    truth = None if campaign is None else true_label(data, campaign, dt=config.dt)
    states = data.state if campaign is None else true_states(data, campaign, dt=config.dt)
    reference = data.label if truth is None else truth
    members = tuple(
        pooled(flight_errors(data, predict(model, data, member=place).body, reference)).combined
        for place in range(len(model.networks))
    )
    evaluation = Evaluation(
        named.name,
        config.kind,
        config.history,
        config.motors,
        config.filtered_inputs,
        label=flight_errors(data, body),
        true=() if truth is None else flight_errors(data, body, truth),
        members=members,
        open_loop=open_loop_errors(model, data, states),
        pulses=() if plant is None else pulse_responses(model, plant, data),
        calibration=calibration(model, data, reference),
    )
    return EvaluatedModel(evaluation, model, data, body)


def _peaks(data: LabelledRows, campaign: Path | None, dt: float) -> tuple[Peak, ...]:
    label = data.label if campaign is None else true_label(data, campaign, dt=dt)
    world = world_accelerations(label, data.state[:, ATTITUDE])
    labelled = np.isfinite(world).all(axis=1)
    peaks = []
    for place, name in enumerate(data.flights):
        rows = world[labelled & (data.flight_of == place)]
        linear, angular = (float(np.linalg.norm(part, axis=1).max(initial=0.0)) for part in (rows[:, :3], rows[:, 3:]))
        peaks.append(Peak(name, linear, angular))
    return tuple(peaks)
