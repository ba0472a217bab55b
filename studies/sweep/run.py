"""A sweep from its options: the cells and their execution."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from dynamics.files import make_folder, write_json
from dynamics.spelling import unknown
from dynamics.vehicle_file import find_vehicle, read_vehicle, vehicle_toml
from flights.folder import CAMPAIGN
from studies.evaluation.run import find_flights
from studies.sweep.about import ABOUT, SweepAbout
from studies.sweep.catalogue import DEFAULT_RANGE, GRID, SEARCH, STARRED, STUDIES, grid_cells
from studies.sweep.cell import Cell, CellResult, Outcome, StudyOptions
from studies.sweep.cell_work import CellWork, file_hash, finished_cells
from studies.sweep.execution import run_cells
from studies.sweep.search import Range, Search
from training.config import ModelConfig
from training.data.logged_flights import find_logs
from training.recipe import Recipe, named_recipe


class SweepOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Options of `alula sweep`.

    study: its name, grid or search.
    logs: to train on, or folders of them.
    tests: to test on; empty for a campaign's test flights.
    simulated: logs or folders of a simulation without effects.
    seeds: trainings of each cell.
    steps, batch: None for the recipe's own.
    grid, over: values and ranges of the fields that are varied.
    trials: of a search, in all.
    jobs: processes, None for one a core.
    scheduler: address of a Dask scheduler.
    """

    study: str
    logs: tuple[Path, ...]
    vehicle: str
    out: Path
    tests: tuple[Path, ...] = ()
    simulated: tuple[Path, ...] = ()
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
    effect_files: tuple[Path, ...] = ()


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep that is ready to run.

    along: the quantities in which its cells differ.
    count: of the cells.
    outcomes: trains the missing cells and gives all.
    finished: gives the finished cells.
    flights: sha256 of all flights, by path.
    works: of the cells; empty for a search, whose cells follow from its results.
    """

    study: str
    along: tuple[str, ...]
    count: int
    outcomes: Callable[[], Iterator[tuple[int, Outcome]]]
    finished: Callable[[], Iterator[tuple[int, CellResult]]]
    flights: Mapping[str, str]
    works: tuple[CellWork, ...] = ()


def make_sweep(options: SweepOptions) -> Sweep:
    """Define the cells and make the folder. Raises RequestError for invalid options."""
    named_recipe(options.recipe)
    numbers = {"steps": options.steps, "batch": options.batch}
    overrides = {name: value for name, value in numbers.items() if value is not None}
    common = StudyOptions(tuple(range(options.seeds)), overrides)
    work = _works(options)
    if options.study == SEARCH:
        return _search(options, work, overrides)
    if options.study == GRID:
        config, recipe = _grid_values(options.grid)
        cells, along = grid_cells(common, options.model, config, recipe), (*config, *recipe)
    elif options.study in STUDIES:
        cells, along = STUDIES[options.study].cells(common), STUDIES[options.study].along
    else:
        raise RequestError(f"unknown study {options.study!r}{unknown(options.study, (*STUDIES, GRID, SEARCH))}")
    works = tuple(work(cell) for cell in cells)
    for one in works:
        one.settled()  # an invalid value ends the sweep before its first training
    _begin(options.out, SweepAbout(options.study, tuple(along), len(works)))
    return Sweep(
        options.study,
        along,
        len(works),
        outcomes=lambda: run_cells(works, jobs=options.jobs, scheduler=options.scheduler),
        finished=lambda: finished_cells(works),
        flights=_hashes(works[0]),
        works=works,
    )


def _begin(folder: Path, about: SweepAbout) -> None:
    """Make the sweep's folder. Raises RequestError when it cannot be written."""
    make_folder(folder, advice="Give another --out.")
    write_json(about, folder / ABOUT)


def _works(options: SweepOptions) -> Callable[[Cell], CellWork]:
    """The function from a cell to its work. Raises RequestError for logs or a vehicle that cannot be used."""
    logs = find_logs(options.logs)
    tests = options.tests or tuple(path for path in options.logs if path.is_dir() and (path / CAMPAIGN).exists())
    if not tests:
        raise RequestError("no flight to judge on was given: give --test, logs or folders that nothing is trained on.")
    simulated = _simulated(options)
    text = vehicle_toml(read_vehicle(find_vehicle(options.vehicle), effect_files=options.effect_files))
    judged = find_flights(tests)
    if shared := {path.resolve() for path in (*logs, *simulated)} & {path.resolve() for path in judged}:
        raise RequestError(f"{min(shared).name} is among both training and test flights. Give it once.")
    logs, judged, simulated, out = (
        tuple(path.resolve() for path in paths) for paths in (logs, judged, simulated, (options.out,))
    )  # for workers in other folders
    return lambda cell: CellWork(cell, out[0], logs, judged, text, options.recipe, options.mapping, simulated=simulated)


def _simulated(options: SweepOptions) -> tuple[Path, ...]:
    """Flights of a simulation without effects. Raises RequestError when they are missing or do not belong here."""
    if (options.study == STARRED) != bool(options.simulated):
        raise RequestError(
            f"--simulated is for the study {STARRED!r}, and it needs it: give the folder of `alula campaign "
            "--no-effects --out FOLDER`."
        )
    return find_logs(options.simulated) if options.simulated else ()


def _hashes(work: CellWork) -> dict[str, str]:
    """sha256 of all flights by the last parts of their paths."""
    return {"/".join(path.parts[-3:]): file_hash(path) for path in (*work.logs, *work.simulated, *work.tests)}


def _search(options: SweepOptions, work: Callable[[Cell], CellWork], overrides: dict[str, Any]) -> Sweep:
    ranges = [Range.parse(text) for text in options.over or (DEFAULT_RANGE,)]
    for item in ranges:
        _require_field(item.name, Recipe)
    jobs = options.jobs if options.jobs is not None else len(os.sched_getaffinity(0))
    search = Search(work, options.model, ranges, options.trials, overrides)
    example = work(Cell(SEARCH, {}, options.model, 0, recipe=overrides))
    example.settled()
    along = tuple(item.name for item in ranges)
    _begin(options.out, SweepAbout(SEARCH, along, options.trials))
    return Sweep(
        SEARCH,
        along,
        options.trials,
        outcomes=lambda: search.run(jobs=jobs, scheduler=options.scheduler),
        finished=search.finished,
        flights=_hashes(example),
    )


def _grid_values(texts: Sequence[str]) -> tuple[dict[str, list[Any]], dict[str, list[Any]]]:
    """Values by field, of the model's configuration and of the recipe. Raises RequestError for other fields."""
    if not texts:
        raise RequestError("a grid needs something to vary: --grid physics_weight=0,0.01,0.1 --grid history=4,20.")
    config: dict[str, list[Any]] = {}
    recipe: dict[str, list[Any]] = {}
    for text in texts:
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
        raise RequestError(f"a recipe has no {name!r}{unknown(name, struct.__struct_fields__)}")


def _value(text: str) -> Any:
    """A number or a truth value where it is one, else the text; the recipe's own types are checked later."""
    try:
        return decode_json(text)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return text
