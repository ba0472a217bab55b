"""Bayesian search over a recipe's numbers (lambda is the paper's future work): Optuna proposes, cells answer."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import msgspec
import optuna
from optuna.distributions import FloatDistribution
from optuna.trial import TrialState, create_trial

from dynamics.errors import RequestError
from studies.sweep.cell import Cell, CellResult, Outcome, trained
from studies.sweep.cells import run_cells
from studies.sweep.work import CellWork, failure, finished

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


@dataclass(frozen=True, eq=False)
class Search:
    """What is searched. make: the work of a cell. recipe: changes that all trials share. trials: in all.

    Judged on the validation flights, never on test flights. Its cells are its memory: a search that was stopped goes
    on, and proposals follow from them alone.
    """

    make: Callable[[Cell], CellWork]
    model: str
    ranges: Sequence[Range]
    trials: int
    recipe: Mapping[str, object]
    seed: int = 0

    def run(self, *, jobs: int, scheduler: str | None) -> Iterator[tuple[int, Outcome]]:
        """(trial, outcome) of every trial, finished ones first; what failed before is tried once more as it was.

        jobs: trials that are proposed and trained at once. Raises RequestError for a folder of another search.
        """
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        known: dict[int, Outcome] = dict(self.tried())
        yield from known.items()
        while missing := [number for number in range(self.trials) if number not in known]:
            again = {number: cell for number in missing if (cell := self._failed_before(number)) is not None}
            cells = again or self._proposed(known, missing[:jobs])
            numbers = list(cells)
            works = [self.make(cell) for cell in cells.values()]
            for place, outcome in run_cells(works, jobs=jobs, scheduler=scheduler):
                known[numbers[place]] = outcome
                yield numbers[place], outcome

    def tried(self) -> Iterator[tuple[int, CellResult]]:
        """(trial, result) of those that are finished. Raises RequestError for another search's files."""
        for number in range(self.trials):
            path = self._work(number).result_file
            if not path.exists():
                continue
            try:
                cell = msgspec.json.decode(path.read_bytes(), type=CellResult).cell
            except (OSError, msgspec.MsgspecError) as error:
                raise RequestError(
                    f"{path} is no cell of a sweep: {error}. Delete it, or give another --out."
                ) from error
            if not self._is_ours(cell):
                raise RequestError(
                    f"{path} is of another search: its model, ranges or recipe differ. Give the same command as "
                    "before, or another --out."
                )
            result = finished(self.make(cell))  # what a trial tried stands in its own file
            if result is not None:
                yield number, result

    def _failed_before(self, number: int) -> Cell | None:
        """What a trial tried that could not be trained, None if it was not tried by this search."""
        found = failure(self._work(number))
        return found.cell if found is not None and self._is_ours(found.cell) else None

    def _proposed(self, known: Mapping[int, Outcome], numbers: Sequence[int]) -> dict[int, Cell]:
        """What to try next; those proposed together keep away from each other."""
        space = {item.name: FloatDistribution(item.low, item.high, log=True) for item in self.ranges}
        sampler = optuna.samplers.TPESampler(
            seed=RANDOM_SEED + len(known), n_startup_trials=STARTUP, constant_liar=len(numbers) > 1
        )
        study = optuna.create_study(sampler=sampler)
        for result in trained([known[number] for number in sorted(known)]):
            params = {name: float(result.cell.at[name]) for name in space}
            state = TrialState.COMPLETE
            study.add_trial(
                create_trial(params=params, distributions=dict(space), value=result.validation, state=state)
            )
        asked = [study.ask(dict(space)) for _ in numbers]
        return {
            number: self._cell(number, {name: float(trial.params[name]) for name in space})
            for number, trial in zip(numbers, asked, strict=True)
        }

    def _cell(self, number: int, values: Mapping[str, float]) -> Cell:
        recipe = {**self.recipe, **values}
        return Cell(f"trial_{number:03d}", {**values}, self.model, self.seed, recipe=recipe)

    def _work(self, number: int) -> CellWork:
        return self.make(self._cell(number, {}))

    def _is_ours(self, cell: Cell) -> bool:
        """Whether a cell could be a trial of this search."""
        values = {item.name: float(cell.at.get(item.name, math.nan)) for item in self.ranges}
        wanted = self._cell(0, values)
        inside = all(item.low <= values[item.name] <= item.high for item in self.ranges)
        return inside and msgspec.structs.replace(cell, name=wanted.name) == wanted
