"""Bayesian search over a recipe's numbers (lambda is the paper's future work) on Optuna's own storage.

`search.journal` in the sweep's folder holds the trials. A trial's training is a cell with files like any other, so that
a killed search resumes its open trainings. Several processes may work on one folder at the same time: each trains
trials that no other one holds.
"""

from __future__ import annotations

import fcntl
import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState, create_trial

from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from dynamics.field_errors import described
from studies.sweep.cell import Cell, CellResult, Outcome
from studies.sweep.cell_work import CellWork, failure, finished
from studies.sweep.execution import run_cells

JOURNAL = "search.journal"
CLAIMS = "search.claims"  # locked while trials are opened and claimed; the journal has a lock of its own
STARTUP = 5  # trials at random before proposals follow earlier results
RANDOM_SEED = 0


@dataclass(frozen=True)
class Range:
    """Limits of a recipe's number, searched on a logarithmic scale."""

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
    """A search in a folder, judged on the validation flights, never on test flights.

    make: the work of a cell.
    model: kind of the networks.
    ranges: of the numbers that are searched.
    trials: in all.
    recipe: overrides that all trials share.
    """

    make: Callable[[Cell], CellWork]
    model: str
    ranges: Sequence[Range]
    trials: int
    recipe: Mapping[str, object]
    seed: int = 0

    def run(self, *, jobs: int, scheduler: str | None) -> Iterator[tuple[int, Outcome]]:
        """(trial, outcome) of every trial, finished ones first; failed ones of earlier runs are repeated as they were.

        A trial that another process holds is left to it and does not appear.

        jobs: trials that are proposed and trained at once.

        Raises RequestError for a folder of another search.
        """
        finished_before = dict(self.finished())
        yield from finished_before.items()
        study = self._open(finished_before)
        attempted = set(finished_before)
        while True:
            with ExitStack() as claims:
                cells = self._claim(study, attempted, jobs, claims)
                if not cells:
                    return
                attempted |= cells.keys()
                numbers = list(cells)
                works = [self.make(cell) for cell in cells.values()]
                for place, outcome in run_cells(works, jobs=jobs, scheduler=scheduler):
                    if isinstance(outcome, CellResult):  # a failed trial stays open: Optuna runs no trial twice
                        study.tell(numbers[place], outcome.validation, skip_if_finished=True)
                    yield numbers[place], outcome

    def finished(self) -> Iterator[tuple[int, CellResult]]:
        """(trial, result) of the finished trials. Raises RequestError for another search's files."""
        for number in range(self.trials):
            path = self._work(number).result_file
            if not path.exists():
                continue
            try:
                cell = decode_json(path.read_bytes(), CellResult).cell
            except (OSError, msgspec.MsgspecError) as error:
                raise RequestError(
                    f"{path} is no cell of a sweep: {described(error)}. Delete it, or give another --out."
                ) from error
            if not self._is_ours(cell):
                raise RequestError(
                    f"{path} is of another search: its model, ranges or recipe differ. Give the same command as "
                    "before, or another --out."
                )
            result = finished(self.make(cell))  # a trial's values are in its own file
            if result is not None:
                yield number, result

    @property
    def _space(self) -> dict[str, BaseDistribution]:
        return {item.name: FloatDistribution(item.low, item.high, log=True) for item in self.ranges}

    @property
    def _folder(self) -> Path:
        return self._work(0).folder

    def _open(self, results: Mapping[int, CellResult]) -> optuna.Study:
        """The study of this search in the folder's journal, with these results in it."""
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        described = msgspec.json.encode([self._work(0).fingerprint, [(r.name, r.low, r.high) for r in self.ranges]])
        with _locked(self._folder / CLAIMS):
            study = optuna.create_study(
                storage=JournalStorage(JournalFileBackend(str(self._folder / JOURNAL))),
                study_name=hashlib.sha256(described).hexdigest()[:16],
                load_if_exists=True,
            )
            trials = study.get_trials(deepcopy=False)
            if not trials:
                self._import_cells(study, results)
            for trial in trials:
                if trial.number in results and not trial.state.is_finished():  # killed before its result was stored
                    study.tell(trial.number, results[trial.number].validation)
        return study

    def _import_cells(self, study: optuna.Study, results: Mapping[int, CellResult]) -> None:
        """Fill a new study with cells that lie in the folder: of a search from before there was a journal."""
        failures = {number: cell for number in range(self.trials) if (cell := self._failed_cell(number)) is not None}
        for number in range(max([*results, *failures], default=-1) + 1):
            if number in results:
                params = {name: float(results[number].cell.at[name]) for name in self._space}
                value = results[number].validation
                study.add_trial(create_trial(params=params, distributions=self._space, value=value))
            elif number in failures:
                study.enqueue_trial({name: float(failures[number].at[name]) for name in self._space})
            else:
                study.enqueue_trial({})

    def _claim(self, study: optuna.Study, attempted: set[int], count: int, claims: ExitStack) -> dict[int, Cell]:
        """Up to `count` trials to train, held by `claims` against other processes: open ones first, then new ones."""
        cells: dict[int, Cell] = {}

        def claim(number: int, values: Mapping[str, float]) -> None:
            lock = _locked(self._folder / f"{self._cell(number, {}).name}.lock", wait=False)
            if claims.enter_context(lock):
                cells[number] = self._cell(number, {name: float(values[name]) for name in self._space})

        with _locked(self._folder / CLAIMS):
            trials = study.get_trials(deepcopy=False)
            for trial in trials[: self.trials]:
                if len(cells) < count and trial.state is TrialState.RUNNING and trial.number not in attempted:
                    claim(trial.number, trial.params)
            waiting = sum(trial.state is TrialState.WAITING for trial in trials[: self.trials])
            unproposed = waiting + max(0, self.trials - len(trials))
            study.sampler = optuna.samplers.TPESampler(
                seed=RANDOM_SEED + len(trials) - waiting, n_startup_trials=STARTUP, constant_liar=True
            )
            for _ in range(min(count - len(cells), unproposed)):
                proposed = study.ask(self._space)
                claim(proposed.number, proposed.params)
        return cells

    def _failed_cell(self, number: int) -> Cell | None:
        """The cell of a trial that failed, None if it did not or belongs to another search."""
        failed = failure(self._work(number))
        return failed.cell if failed is not None and self._is_ours(failed.cell) else None

    def _cell(self, number: int, values: Mapping[str, float]) -> Cell:
        recipe = {**self.recipe, **values}
        return Cell(f"trial_{number:03d}", {**values}, self.model, self.seed, recipe=recipe)

    def _work(self, number: int) -> CellWork:
        return self.make(self._cell(number, {}))

    def _is_ours(self, cell: Cell) -> bool:
        """Whether a cell could be a trial of this search."""
        values = {item.name: float(cell.at.get(item.name, math.nan)) for item in self.ranges}
        expected = self._cell(0, values)
        inside = all(item.low <= values[item.name] <= item.high for item in self.ranges)
        return inside and msgspec.structs.replace(cell, name=expected.name) == expected


@contextmanager
def _locked(path: Path, *, wait: bool = True) -> Iterator[bool]:
    """Hold a file's lock; it ends with the process at the latest. Gives whether it is held. wait: until it is free."""
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True  # the file stays: whoever opened it before it was removed would lock a file of no name
