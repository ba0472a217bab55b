"""Bayesian search over a recipe's numbers (lambda is the paper's future work): Optuna proposes, cells answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import msgspec
import optuna
from optuna.distributions import FloatDistribution
from optuna.trial import TrialState, create_trial

from alula.sweep_cells import CellWork, finished, run_cells
from dynamics.errors import RequestError
from training.studies.cell import Cell, CellResult

STARTUP = 5  # trials at random before proposals follow what was found
RANDOM_SEED = 0


@dataclass(frozen=True)
class Range:
    """A recipe's number and where it is looked for, on a logarithmic scale."""

    name: str
    low: float
    high: float

    @classmethod
    def parse(cls, text: str) -> Range:
        """`physics_weight=1e-4:1`. Raises RequestError for anything else."""
        name, _, limits = text.partition("=")
        try:
            low, high = (float(limit) for limit in limits.split(":"))
        except ValueError:
            low = high = math.nan
        if not (name and 0 < low < high < math.inf):
            raise RequestError(f"{text!r} is no range. Give NAME=LOW:HIGH with 0 < LOW < HIGH, physics_weight=1e-4:1.")
        return cls(name, low, high)


def search(
    make: Callable[[Cell], CellWork], model: str, ranges: Sequence[Range], trials: int, *, seed: int,
    recipe: dict[str, object], jobs: int, scheduler: str | None,
) -> Iterator[tuple[int, CellResult]]:  # fmt: skip
    """(trial, result) of every trial, finished ones first; judged on the validation flights, never on test flights.

    make: the work of a cell. jobs: trials that are proposed and trained at once. A search that was stopped goes on: its
    cells are its memory, and proposals follow from them alone.
    """
    space = {item.name: FloatDistribution(item.low, item.high, log=True) for item in ranges}
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    done = tried(make, model, trials)
    yield from enumerate(done)
    while len(done) < trials:
        first = len(done)
        proposals = _propose(space, done, min(jobs, trials - first))
        cells = [
            Cell(_name(first + place), {**values}, model, seed, recipe={**recipe, **values})
            for place, values in enumerate(proposals)
        ]
        found = dict(run_cells([make(cell) for cell in cells], jobs=jobs, scheduler=scheduler))
        for place in range(len(cells)):
            done.append(found[place])
            yield first + place, found[place]


def tried(make: Callable[[Cell], CellWork], model: str, trials: int) -> list[CellResult]:
    """The trials that are finished, up to the first one that is not. Raises RequestError for another sweep's files."""
    found: list[CellResult] = []
    while len(found) < trials and (result := _stored(make, Cell(_name(len(found)), {}, model, 0))) is not None:
        found.append(result)
    return found


def _propose(space: dict[str, FloatDistribution], done: Sequence[CellResult], wanted: int) -> list[dict[str, float]]:
    """What to try next; those proposed together keep away from each other."""
    sampler = optuna.samplers.TPESampler(
        seed=RANDOM_SEED + len(done), n_startup_trials=STARTUP, constant_liar=wanted > 1
    )
    study = optuna.create_study(sampler=sampler)
    for result in done:
        params = {name: float(result.cell.at[name]) for name in space}
        study.add_trial(
            create_trial(params=params, distributions=dict(space), value=result.validation, state=TrialState.COMPLETE)
        )
    asked = [study.ask(dict(space)) for _ in range(wanted)]
    return [{name: float(trial.params[name]) for name in space} for trial in asked]


def _stored(make: Callable[[Cell], CellWork], cell: Cell) -> CellResult | None:
    """A trial of an earlier run. What it tried stands in its own file, so that is taken from there."""
    path = make(cell).result_file
    if not path.exists():
        return None
    try:
        tried = msgspec.json.decode(path.read_bytes(), type=CellResult).cell
    except msgspec.MsgspecError as error:
        raise RequestError(f"{path} is no cell of a sweep: {error}. Delete it, or give another --out.") from error
    return finished(make(tried))


def _name(number: int) -> str:
    return f"trial_{number:03d}"
