"""A sweep from what was asked for: its cells, the map that runs them, what is made of their results."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from alula.evaluation_run import find_flights
from alula.study_tables import search_table, study_figure, study_table
from alula.sweep_cells import CellWork, finished_cells, run_cells
from alula.sweep_search import Range, search, tried
from alula.tables import Table
from dynamics.errors import RequestError
from dynamics.vehicle_file import read_vehicle, vehicle_toml
from training import figures
from training.config import ModelConfig
from training.recipe import Recipe, named_recipe
from training.recordings import CAMPAIGN, find_logs
from training.studies import STUDIES, grid_cells
from training.studies.cell import Cell, CellResult, StudyOptions
from vehicles import vehicle_path

GRID, SEARCH = "grid", "search"
SEARCHED = "physics_weight=1e-4:1"  # lambda


class SweepOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What `alula sweep` was asked for."""

    study: str
    logs: tuple[Path, ...]
    vehicle: str
    out: Path
    tests: tuple[Path, ...] = ()
    seeds: int = 2
    steps: int | None = None
    batch: int | None = None
    recipe: str = "fast"
    model: str = "pi_tcn"
    grid: tuple[str, ...] = ()
    over: tuple[str, ...] = ()
    trials: int = 20
    jobs: int | None = None
    scheduler: str | None = None
    mapping: Path | None = None


class Answer(msgspec.Struct, frozen=True):
    """`alula sweep --json`."""

    study: str
    cells: tuple[CellResult, ...]


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep that may begin. along: the quantities that cells differ in. count: of the cells.

    results: trains what is missing. finished: what is there already.
    """

    study: str
    along: tuple[str, ...]
    count: int
    results: Callable[[], Iterator[tuple[int, CellResult]]]
    finished: Callable[[], Iterator[tuple[int, CellResult]]]


def make_sweep(options: SweepOptions) -> Sweep:
    """Settle the cells and make the folder. Raises RequestError for whatever makes no sense."""
    named_recipe(options.recipe)
    work = _works(options)
    changes = {name: value for name, value in (("steps", options.steps), ("batch", options.batch)) if value is not None}
    common = StudyOptions(tuple(range(options.seeds)), changes)
    if options.study == SEARCH:
        return _search(options, work, changes)
    if options.study == GRID:
        config, recipe = _grid_values(options.grid)
        cells, along = grid_cells(common, options.model, config, recipe), (*config, *recipe)
    elif options.study in STUDIES:
        cells, along = STUDIES[options.study].cells(common), STUDIES[options.study].along
    else:
        raise RequestError(f"unknown study {options.study!r}. Known: {', '.join((*STUDIES, GRID, SEARCH))}.")
    works = [work(cell) for cell in cells]
    return Sweep(
        options.study, along, len(works),
        results=lambda: run_cells(works, jobs=options.jobs, scheduler=options.scheduler),
        finished=lambda: finished_cells(works),
    )  # fmt: skip


def table_of(sweep: Sweep, results: Sequence[CellResult]) -> Table:
    """The study's table."""
    if sweep.study == SEARCH:
        return search_table(sweep.along, results)
    return study_table(sweep.study, sweep.along, results)


def draw(sweep: Sweep, results: Sequence[CellResult], folder: Path) -> list[Path]:
    """The study's picture, PNG and PDF."""
    return figures.save(study_figure(sweep.study, sweep.along, results), folder, sweep.study)


def _works(options: SweepOptions) -> Callable[[Cell], CellWork]:
    """What makes a cell's work. Raises RequestError for logs, a vehicle or a folder that cannot be used."""
    logs = find_logs(options.logs)
    tests = options.tests or tuple(path for path in options.logs if path.is_dir() and (path / CAMPAIGN).exists())
    if not tests:
        raise RequestError("no flight to judge on was given: give --test, logs or folders that nothing is trained on.")
    text = vehicle_toml(read_vehicle(vehicle_path(options.vehicle)))
    judged = find_flights(tests)
    if shared := {path.resolve() for path in logs} & {path.resolve() for path in judged}:
        raise RequestError(f"{min(shared).name} is among both training and test flights. Give it once.")
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RequestError(f"cannot write to {options.out}: {error.strerror}. Give another --out.") from error
    logs, judged, out = (tuple(p.resolve() for p in paths) for paths in (logs, judged, (options.out,)))  # for workers
    return lambda cell: CellWork(cell, out[0], logs, judged, text, options.recipe, options.mapping)


def _search(options: SweepOptions, work: Callable[[Cell], CellWork], changes: dict[str, Any]) -> Sweep:
    ranges = [Range.parse(text) for text in options.over or (SEARCHED,)]
    for item in ranges:
        _require_field(item.name, Recipe)
    jobs = options.jobs if options.jobs is not None else len(os.sched_getaffinity(0))

    def results() -> Iterator[tuple[int, CellResult]]:
        return search(
            work, options.model, ranges, options.trials, seed=0, recipe=changes, jobs=jobs, scheduler=options.scheduler
        )

    def finished() -> Iterator[tuple[int, CellResult]]:
        return iter(enumerate(tried(work, options.model, options.trials)))

    return Sweep(SEARCH, tuple(item.name for item in ranges), options.trials, results, finished)


def _grid_values(given: Sequence[str]) -> tuple[dict[str, list[Any]], dict[str, list[Any]]]:
    """Values by field, of the model's definition and of the recipe. Raises RequestError for what is neither."""
    if not given:
        raise RequestError("a grid needs something to vary: --grid physics_weight=0,0.01,0.1 --grid history=4,20.")
    config: dict[str, list[Any]] = {}
    recipe: dict[str, list[Any]] = {}
    for text in given:
        name, _, values = text.partition("=")
        into = config if name in ModelConfig.__struct_fields__ else recipe
        if into is recipe:
            _require_field(name, Recipe)
        if not values:
            raise RequestError(f"{text!r} has no values. Give NAME=VALUE,VALUE,...")
        into[name] = [_value(value) for value in values.split(",")]
    return config, recipe


def _require_field(name: str, struct: type[msgspec.Struct]) -> None:
    if name not in struct.__struct_fields__:
        raise RequestError(f"a recipe has no {name!r}. Known: {', '.join(struct.__struct_fields__)}.")


def _value(text: str) -> Any:
    """A number or a truth value where it is one, else the text; the recipe's own types are checked later."""
    try:
        return msgspec.json.decode(text)
    except msgspec.MsgspecError:
        return text
