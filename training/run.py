"""A training from logs to a checkpoint: what was asked for, the members in their processes, what they leave behind.

While it runs, `MODEL.pt.run` holds what every member goes on from after it was killed.
"""

from __future__ import annotations

import dataclasses
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import torch

from dynamics.command import command_line
from dynamics.errors import RequestError
from dynamics.files import write_whole
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import find_vehicle, parse_effect, read_vehicle
from flights.parallel import parallel_map
from training import checkpoint, process_group
from training.checkpoint import TrainedModel
from training.config import ModelConfig, convolutions_for
from training.data.recordings import find_logs, left_out, read_recordings, split_recordings
from training.effects_fit import named_effects
from training.folder import CARD_SUFFIX, PROGRESS, STATE, claimed, require_free, run_folder
from training.models import named_kind
from training.overrides import changed
from training.plan import Plan, make_plan
from training.progress import Report
from training.recipe import Recipe, named_recipe
from training.trainer import Member, Task, train

POLL = 0.5  # s
MAX_SEED = 2**31
Progress = Callable[[Report], None]


class TrainOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What `alula train` was asked for. config, recipe_changes: fields that differ from the model's and the recipe's.

    effects: added to the vehicle file's, as on the command line. ensemble: members. jobs: processes, None for one a
    core.
    """

    logs: tuple[Path, ...]
    vehicle: str
    model: str
    out: Path
    recipe: str = "fast"
    config: dict[str, Any] = {}
    recipe_changes: dict[str, Any] = {}
    effects: tuple[str, ...] = ()
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
        """Where members keep what they go on from."""
        return run_folder(self.out)

    @property
    def seeds(self) -> tuple[int, ...]:
        """One for each member."""
        return tuple(range(self.seed, self.seed + self.ensemble))


def run(options: TrainOptions, progress: Progress) -> TrainedModel:
    """Train every member, write the model and its card beside it. progress: told of each member's evaluations.

    Raises RequestError, DataError for what a user can cause.
    """
    device = process_group.find_device(options.device)
    rank, size = process_group.join_group(device)
    try:
        if rank:
            require_free(options.out, overwrite=options.overwrite)
            return _train(options, device, size, progress)
        with claimed(options.out, options.folder, overwrite=options.overwrite, resume=options.resume):
            model = _train(options, device, size, progress)
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


def _train(options: TrainOptions, device: torch.device, size: int, progress: Progress) -> TrainedModel:
    plan = plan_of(options)
    members = _train_members(options, plan, device, size, progress) if plan.config.network != "none" else ()
    return plan.assemble(members, options.seeds, command=command_line())


def plan_of(options: TrainOptions) -> Plan:
    """Read vehicle and flights, and settle what is learned. Raises RequestError, DataError."""
    vehicle = _vehicle(options)
    config, recipe = settled(options)
    logs = find_logs(options.logs)
    recordings = read_recordings(logs, dt=config.dt, mapping=options.mapping)
    split = split_recordings(recordings, validation=options.validation, hold_out=options.hold_out)
    split = dataclasses.replace(split, notes=(*left_out(logs, recordings), *split.notes))
    return make_plan(config, recipe, vehicle, split, seed=options.seed, fit=not options.keep_effects)


def settled(options: TrainOptions) -> tuple[ModelConfig, Recipe]:
    """Definition and recipe with the options' changes. Raises RequestError for values that make no sense."""
    if options.ensemble < 1:
        raise RequestError(f"an ensemble of {options.ensemble} members: wanted 1 or more.")
    if not 0 <= options.seed <= MAX_SEED:
        raise RequestError(f"seed {options.seed}: wanted 0 to {MAX_SEED}.")
    kind, recipe = named_kind(options.model), named_recipe(options.recipe)
    config = kind.config_for(recipe)
    changes = dict(options.config)
    if "inputs" in changes and config.outputs != "wrench":
        changes.setdefault("outputs", changes["inputs"])
    if "history" in changes and config.network == "tcn":
        changes["kernel"], changes["dilations"] = convolutions_for(changes["history"])
    recipe = kind.recipe_for(recipe)
    if "steps" in options.recipe_changes:
        recipe = msgspec.structs.replace(recipe, epochs=None)
    return changed(config, changes), changed(recipe, options.recipe_changes)


def write_card(model: TrainedModel, out: Path) -> Path:
    """The card as JSON beside the model. Raises RequestError when it cannot be written."""
    text = msgspec.json.format(msgspec.json.encode(model.card)) + b"\n"
    advice = f"The model itself is in {out}."
    return write_whole(out.with_suffix(CARD_SUFFIX), lambda part: part.write_bytes(text), advice=advice)


def _vehicle(options: TrainOptions) -> Vehicle:
    vehicle = read_vehicle(find_vehicle(options.vehicle))
    uses = [parse_effect(text, vehicle.rotors.count) for text in options.effects]
    return named_effects(vehicle, uses)


@dataclass(frozen=True, eq=False)
class _Job:
    task: Task
    progress_file: Path


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
    work = [_Job(task, options.folder / PROGRESS.format(task.member)) for task in tasks]
    with _watched([job.progress_file for job in work], progress):
        found = dict(parallel_map(_work, work, jobs=jobs))
    return [found[place] for place in range(len(work))]


def _work(job: _Job) -> Member:
    """One member in a process of its own, which tells where it stands through a file."""

    def tell(report: Report) -> None:
        part = job.progress_file.with_suffix(".part")
        part.write_bytes(msgspec.json.encode(report))
        part.replace(job.progress_file)

    with one_thread(job.task.training.inputs.device):
        return train(job.task, tell)


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


@contextmanager
def _watched(files: Sequence[Path], progress: Progress) -> Iterator[None]:
    """Hand on what the members tell through their files while something else waits for them."""
    over = threading.Event()
    told: dict[Path, bytes] = {}

    def look() -> None:
        for file in files:
            if file.exists() and told.get(file) != (text := file.read_bytes()):
                told[file] = text
                progress(msgspec.json.decode(text, type=Report))

    def watch() -> None:
        while not over.wait(POLL):
            look()

    for file in files:
        file.unlink(missing_ok=True)
    thread = threading.Thread(target=watch, name="training progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        look()
