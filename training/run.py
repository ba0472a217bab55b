"""A training from logs to a checkpoint: options, the members in their processes, model and card.

While it runs, `MODEL.pt.run` holds the state from which each member continues after it was killed. Its course is in
`MODEL.progress.jsonl`.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import torch

from dynamics.command import command_line
from dynamics.errors import RequestError
from dynamics.files import write_whole
from dynamics.own_effects import catalogue_of
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import find_vehicle, parse_effect, read_vehicle
from flights.parallel import parallel_map
from training import checkpoint, process_group
from training.checkpoint import TrainedModel
from training.config import ModelConfig, convolutions_for
from training.data.labelled_rows import with_logged_motors
from training.data.logged_flights import find_logs, left_out, names_of, read_logged_flights, split_flights
from training.diagnosed_effects import DIAGNOSED, with_diagnosed_effects
from training.effects_fit import named_effects
from training.folder import CARD_SUFFIX, STATE, claimed, require_free, run_folder
from training.models import named_kind
from training.overrides import overridden
from training.plan import Plan, make_plan
from training.progress_file import append, begin, progress_file
from training.recipe import Recipe, named_recipe
from training.reports import Progress, Report, progress_channel
from training.trainer import Member, Task, train

MAX_SEED = 2**31


class TrainOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The options of `alula train`.

    logs: logs, folders of logs, a campaign's folder.
    vehicle: a shipped vehicle or a vehicle file.
    model: kind of model (`training.models`).
    out: the checkpoint to write.
    recipe: name of the recipe.
    config: overrides of the model's definition.
    recipe_overrides: overrides of the recipe.
    effects: added to the vehicle file's, as on the command line; "diagnosed" for those that a diagnosis names.
    effect_files: with effects of the user's own, beside those that the vehicle names.
    keep_effects: whether effects keep the vehicle file's values instead of being fitted.
    validation, hold_out: patterns of file names.
    mapping: columns of tables that are not recognised.
    seed: of the first member; each further member has the next one.
    ensemble: number of members.
    jobs: processes, None for one a core.
    device: of torch.
    resume: whether to continue a training that was killed.
    overwrite: whether a model that exists may be replaced.
    """

    logs: tuple[Path, ...]
    vehicle: str
    model: str
    out: Path
    recipe: str = "fast"
    config: dict[str, Any] = {}
    recipe_overrides: dict[str, Any] = {}
    effects: tuple[str, ...] = ()
    effect_files: tuple[Path, ...] = ()
    keep_effects: bool = False
    validation: str | None = None
    hold_out: str | None = None
    mapping: Path | None = None
    seed: int = 0
    ensemble: int = 4
    jobs: int | None = None
    device: str = "cpu"
    resume: bool = False
    overwrite: bool = False

    @property
    def folder(self) -> Path:
        """Folder of the members' saved states."""
        return run_folder(self.out)

    @property
    def seeds(self) -> tuple[int, ...]:
        """One for each member."""
        return tuple(range(self.seed, self.seed + self.ensemble))


def run(options: TrainOptions, progress: Progress) -> TrainedModel:
    """Train every member, write the model and its card. progress: called at each member's evaluations.

    Raises RequestError, DataError for what a user can cause.
    """
    device = process_group.find_device(options.device)
    rank, size = process_group.join_group(device)
    try:
        if rank:
            require_free(options.out, overwrite=options.overwrite)
            return _train(options, device, size, progress)
        with claimed(options.out, options.folder, overwrite=options.overwrite, resume=options.resume):
            model = _train(options, device, size, progress, is_recorded=True)
            checkpoint.save(model, options.out)
            write_card(model, options.out)
            return model
    except (MemoryError, RuntimeError) as error:
        if not isinstance(error, (MemoryError, torch.OutOfMemoryError)) and "allocate memory" not in str(error):
            raise
        raise RequestError(
            "there is not enough memory for this training. Give a smaller --batch, a shorter --history, fewer --jobs, "
            "or fewer flights."
        ) from error
    finally:
        process_group.leave_group()


def _recorded(options: TrainOptions, progress: Progress) -> Progress:
    """Progress that is written beside the model, too, from the first evaluation on: what is refused leaves no file."""
    path, began = progress_file(options.out), False

    def record(report: Report) -> None:
        nonlocal began
        if not began:
            begin(path, options.ensemble, command_line(), resume=options.resume)
            began = True
        append(path, report)
        progress(report)

    return record


def _train(
    options: TrainOptions, device: torch.device, size: int, progress: Progress, *, is_recorded: bool = False
) -> TrainedModel:
    plan = plan_of(options)
    members: Sequence[Member] = ()
    if plan.config.network != "none":
        members = _train_members(options, plan, device, size, _recorded(options, progress) if is_recorded else progress)
    return plan.assemble(members, options.seeds, command=command_line())


def plan_of(options: TrainOptions) -> Plan:
    """Read vehicle and flights and make the plan of the training. Raises RequestError, DataError."""
    vehicle = _vehicle(options)
    config, recipe = settled(options)
    logs = find_logs(options.logs, options.mapping)
    recordings = read_logged_flights(logs, dt=config.dt, mapping=options.mapping)
    split = split_flights(recordings, validation=options.validation, hold_out=options.hold_out)
    split = dataclasses.replace(split, notes=(*left_out(logs, recordings), *split.notes))
    if DIAGNOSED in options.effects:
        learned = {flight.name for flight in split.training}
        paths = [path for name, path in zip(names_of(logs), logs, strict=True) if name in learned]
        logged = with_logged_motors(config, (*split.training, *split.validation), vehicle)
        vehicle, note = with_diagnosed_effects(logged, vehicle, paths, mapping=options.mapping)
        split = dataclasses.replace(split, notes=(*split.notes, note))
    return make_plan(config, recipe, vehicle, split, seed=options.seed, fit=not options.keep_effects)


def settled(options: TrainOptions) -> tuple[ModelConfig, Recipe]:
    """Definition and recipe with the options' overrides. Raises RequestError for values that are not allowed."""
    if options.ensemble < 1:
        raise RequestError(f"an ensemble of {options.ensemble} members: required is 1 or more.")
    if not 0 <= options.seed <= MAX_SEED:
        raise RequestError(f"seed {options.seed}: required is 0 to {MAX_SEED}.")
    kind, recipe = named_kind(options.model), named_recipe(options.recipe)
    config = kind.config_for(recipe)
    overrides = dict(options.config)
    if "inputs" in overrides and config.outputs != "wrench":
        overrides.setdefault("outputs", overrides["inputs"])
    if "history" in overrides and config.network == "tcn":
        overrides["kernel"], overrides["dilations"] = convolutions_for(overrides["history"])
    recipe = kind.recipe_for(recipe)
    if "steps" in options.recipe_overrides:
        recipe = msgspec.structs.replace(recipe, epochs=None)
    return overridden(config, overrides), overridden(recipe, options.recipe_overrides)


def write_card(model: TrainedModel, out: Path) -> Path:
    """The card as JSON in the model's folder. Raises RequestError when it cannot be written."""
    text = msgspec.json.format(msgspec.json.encode(model.card)) + b"\n"
    advice = f"The model itself is in {out}."
    return write_whole(out.with_suffix(CARD_SUFFIX), lambda part: part.write_bytes(text), advice=advice)


def _vehicle(options: TrainOptions) -> Vehicle:
    vehicle = read_vehicle(find_vehicle(options.vehicle), effect_files=options.effect_files)
    catalogue, texts = catalogue_of(vehicle), [text for text in options.effects if text != DIAGNOSED]
    return named_effects(vehicle, [parse_effect(text, vehicle.rotors.count, catalogue=catalogue) for text in texts])


def _train_members(
    options: TrainOptions, plan: Plan, device: torch.device, size: int, progress: Progress
) -> Sequence[Member]:
    tasks = [
        plan.task(place, seed, device=device, state_file=options.folder / STATE.format(place))
        for place, seed in enumerate(options.seeds)
    ]
    jobs = options.jobs if options.jobs is not None else len(os.sched_getaffinity(0))
    if device.type != "cpu" or size > 1 or jobs == 1 or len(tasks) == 1:
        with one_thread(device):
            return [train(task, progress) for task in tasks]
    with progress_channel(progress) as report:
        members = dict(parallel_map(partial(_train_alone, report=report), tasks, jobs=jobs))
    return [members[place] for place in range(len(tasks))]


def _train_alone(task: Task, *, report: Progress) -> Member:
    """One member in a process of its own."""
    with one_thread(task.training.inputs.device):
        return train(task, report)


@contextmanager
def one_thread(device: torch.device) -> Iterator[None]:
    """On a CPU networks this small run fastest, and to the same bits, in one thread."""
    before = torch.get_num_threads()
    if device.type == "cpu":
        torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
