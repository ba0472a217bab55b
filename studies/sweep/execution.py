"""Execution of a sweep's cells: finished ones are never trained again, killed ones resume, failed ones are retried."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from dynamics.errors import AlulaError
from dynamics.files import write_whole
from flights.parallel import parallel_map
from studies.sweep.cell import FailedCell, Outcome
from studies.sweep.cell_training import CPU, this_worker, train_cell
from studies.sweep.cell_work import CellWork, finished, finished_cells
from training.run import one_thread

# torch's seed is one for all threads of a process, and a Dask worker may have several
_ONE_AT_A_TIME = threading.Lock()


def run_cells(works: Sequence[CellWork], *, jobs: int | None, scheduler: str | None) -> Iterator[tuple[int, Outcome]]:
    """(place, outcome) of every cell, finished ones first, the others as they finish; failed ones are retried.

    Raises what `parallel_map` raises and RequestError for a folder of another sweep.
    """
    done = dict(finished_cells(works))
    yield from done.items()
    waiting = [place for place in range(len(works)) if place not in done]
    for index, outcome in parallel_map(run_cell, [works[place] for place in waiting], jobs=jobs, scheduler=scheduler):
        yield waiting[index], outcome


def run_cell(work: CellWork) -> Outcome:
    """Train and evaluate one cell and write its files, or read them if another process was faster.

    Raises RequestError for a folder of another sweep, or one that cannot be written to.
    """
    with _ONE_AT_A_TIME, one_thread(CPU):
        result = finished(work)
        if result is not None:
            return result
        try:
            result = train_cell(work)
        except Exception as error:  # of any kind: the other trainings continue
            return _failed(work, error)
        _write(work.result_file, result)
        for path in (work.state_file, work.failure_file):
            path.unlink(missing_ok=True)
        return result


def _failed(work: CellWork, error: Exception) -> FailedCell:
    """Write why a cell could not be trained, and delete its progress, so that a retry starts from the beginning."""
    expected = isinstance(error, AlulaError)
    message = str(error) if expected else f"{type(error).__name__}: {error}"
    failed = FailedCell(work.cell, message, this_worker(), "" if expected else traceback.format_exc())
    _write(work.failure_file, failed)
    work.state_file.unlink(missing_ok=True)
    return failed


def _write(path: Path, value: msgspec.Struct) -> None:
    text = msgspec.json.format(msgspec.json.encode(value)) + b"\n"
    write_whole(path, lambda part: part.write_bytes(text), advice="Free some space.")
