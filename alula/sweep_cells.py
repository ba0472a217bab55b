"""Trainings of a study as files: a finished one is never trained again, a killed one goes on where it was."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import socket
import threading
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
import torch

from alula.inference import time_network
from alula.parallel import parallel_map
from alula.training_run import TrainOptions, one_thread, settled
from dynamics.errors import RequestError
from dynamics.vehicle_file import parse_vehicle
from training import checkpoint
from training.dataset import Dataset
from training.evaluation import seen_by
from training.plan import Plan, make_plan
from training.prediction import flight_errors, predict
from training.recordings import Recording, read_recordings, split_recordings
from training.studies.cell import Cell, CellResult, with_factors
from training.tensors import make_scaling
from training.trainer import train
from training.truth import campaign_of, true_label

CPU = torch.device("cpu")
_ONE_AT_A_TIME = (
    threading.Lock()
)  # torch's seed is one for all threads of a process, and a Dask worker may have several


class CellWork(msgspec.Struct, frozen=True):
    """A cell, the flights it learns from and is judged on, and the folder that its files go to.

    folder: one that every worker sees. recipe: its name.
    """

    cell: Cell
    folder: Path
    logs: tuple[Path, ...]
    tests: tuple[Path, ...]
    vehicle_text: str
    recipe: str = "fast"
    mapping: Path | None = None

    @property
    def result_file(self) -> Path:
        """That it is there says that the cell is finished."""
        return self.folder / f"{self.cell.name}.json"

    @property
    def model_file(self) -> Path:
        """The trained model."""
        return self.folder / f"{self.cell.name}.pt"

    @property
    def fingerprint(self) -> str:
        """Of everything that decides the result."""
        logs, tests = ([str(path.resolve()) for path in paths] for paths in (self.logs, self.tests))
        return hashlib.sha256(msgspec.json.encode([self.cell, logs, tests, self.vehicle_text, self.recipe])).hexdigest()


def finished(work: CellWork) -> CellResult | None:
    """What a cell has become, None while it is not finished. Raises RequestError for a file of another sweep."""
    try:
        result = msgspec.json.decode(work.result_file.read_bytes(), type=CellResult)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError) as error:
        raise RequestError(
            f"{work.result_file} is no cell of a sweep: {error}. Delete it, or give another --out."
        ) from (error)
    if result.fingerprint != work.fingerprint:
        raise RequestError(
            f"{work.result_file} is of another sweep: its flights, vehicle or options differ. Give the same command as "
            "before, or another --out."
        )
    return result


def finished_cells(works: Sequence[CellWork]) -> Iterator[tuple[int, CellResult]]:
    """(place, result) of the cells that are finished. Raises RequestError for a folder of another sweep."""
    for place, work in enumerate(works):
        result = finished(work)
        if result is not None:
            yield place, result


def run_cells(
    works: Sequence[CellWork], *, jobs: int | None, scheduler: str | None
) -> Iterator[tuple[int, CellResult]]:
    """(place, result) of every cell, finished ones first, the others as they finish.

    Raises what `parallel_map` raises and RequestError for a folder of another sweep.
    """
    done = dict(finished_cells(works))
    yield from done.items()
    waiting = [place for place in range(len(works)) if place not in done]
    for index, result in parallel_map(run_cell, [works[place] for place in waiting], jobs=jobs, scheduler=scheduler):
        yield waiting[index], result


def run_cell(work: CellWork) -> CellResult:
    """Train and judge one cell and write its files, or read them if another process was faster."""
    with _ONE_AT_A_TIME, one_thread(CPU):
        result = finished(work)
        if result is None:
            result = _train_cell(work)
    return result


def _train_cell(work: CellWork) -> CellResult:
    cell, state_file = work.cell, work.folder / f"{work.cell.name}.state"
    plan = _plan(work)
    if cell.hide_motors:
        plan = _without_motors(plan)
    member = train(plan.task(0, cell.seed, device=CPU, state_file=state_file), lambda _: None)
    model = plan.assemble([member], [cell.seed], command=f"alula sweep, cell {cell.name}")
    if not cell.prior:  # a wrong prior's model is for its figures alone, and its vehicle file may be refused
        checkpoint.save(model, work.model_file)
    data = seen_by(model, _recordings(work.tests, plan.config.dt, work.mapping, True))
    campaign = campaign_of(work.tests)
    truth = None if campaign is None else true_label(data, campaign, dt=plan.config.dt)
    shown = _blind(data, plan.config.rotors) if cell.hide_motors else data
    body = predict(model, shown).body
    result = CellResult(
        cell, work.fingerprint, flight_errors(data, body),
        () if truth is None else flight_errors(data, body, truth), member.validation, member.steps,
        round(member.seconds, 2), time_network(model, data), f"{socket.gethostname()} {os.getpid()}",
    )  # fmt: skip
    _write(work.result_file, result)
    state_file.unlink(missing_ok=True)
    return result


def _plan(work: CellWork) -> Plan:
    """What `alula train` would learn, from a prior that may be wrong. Raises RequestError when no flight is left."""
    cell = work.cell
    logs = tuple(log for log in work.logs if fnmatchcase(log.name, cell.flights))
    if not logs:
        raise RequestError(f"no training flight is called {cell.flights!r}, which {cell.name} learns from.")
    config, recipe = settled(
        TrainOptions(
            logs=logs, vehicle="", model=cell.model, out=work.model_file, recipe=work.recipe, config=cell.config,
            recipe_changes=cell.recipe, ensemble=1,
        )
    )  # fmt: skip
    vehicle = with_factors(parse_vehicle(work.vehicle_text), cell.prior)
    split = split_recordings(_recordings(logs, config.dt, work.mapping, False))
    return make_plan(config, recipe, vehicle, split, seed=cell.seed)


@lru_cache(maxsize=4)
def _recordings(logs: tuple[Path, ...], dt: float, mapping: Path | None, may_be_tests: bool) -> tuple[Recording, ...]:
    """Flights, which the cells of a sweep share: reading sixty takes as long as a thousand steps of training."""
    return read_recordings(logs, dt=dt, mapping=mapping, may_be_tests=may_be_tests)


def _without_motors(plan: Plan) -> Plan:
    """The plan of a network that is shown standing motors. Raises RequestError with the physics-inspired loss."""
    if plan.points is not None:
        raise RequestError("a network without motors has no physics-inspired loss: give --physics-weight 0.")
    training, validation = (_blind(data, plan.config.rotors) for data in (plan.training, plan.validation))
    scaling = make_scaling(plan.config, plan.recipe, plan.vehicle, training)
    return dataclasses.replace(
        plan, training=training, validation=validation, scaling=scaling, fingerprint=f"{plan.fingerprint} blind"
    )


def _blind(data: Dataset, rotors: int) -> Dataset:
    inputs = np.array(data.inputs)
    inputs[:, -rotors:] = 0.0
    return dataclasses.replace(data, inputs=inputs)


def _write(path: Path, result: CellResult) -> None:
    part = path.with_name(f"{path.name}.{os.getpid()}.part")  # two workers may finish the same cell
    try:
        part.write_bytes(msgspec.json.format(msgspec.json.encode(result)) + b"\n")
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise RequestError(f"cannot write {path}: {error.strerror or error}. Free some space.") from error
