"""A cell with its inputs and its files in the sweep's folder."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import msgspec

from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from dynamics.field_errors import described
from flights.source import sha256
from studies.sweep.cell import Cell, CellResult, FailedCell
from training.config import ModelConfig
from training.recipe import Recipe
from training.run import TrainOptions, settled


class CellWork(msgspec.Struct, frozen=True):
    """A cell with everything that a worker needs for it.

    folder: of its files, on a disk that every worker shares.
    logs, tests: flights to train on and to test on.
    vehicle_text: the vehicle file.
    recipe: its name.
    mapping: column mapping of foreign CSV files.
    simulated: flights of a simulation without effects, for the cells that are trained on those.
    """

    cell: Cell
    folder: Path
    logs: tuple[Path, ...]
    tests: tuple[Path, ...]
    vehicle_text: str
    recipe: str = "fast"
    mapping: Path | None = None
    simulated: tuple[Path, ...] = ()

    @property
    def result_file(self) -> Path:
        """The result; it exists when the cell is finished."""
        return self.folder / f"{self.cell.name}.json"

    @property
    def failure_file(self) -> Path:
        """The failure of the last attempt."""
        return self.folder / f"{self.cell.name}.failed"

    @property
    def state_file(self) -> Path:
        """Progress from which a killed training resumes."""
        return self.folder / f"{self.cell.name}.state"

    @property
    def model_file(self) -> Path:
        """The trained model."""
        return self.folder / f"{self.cell.name}.pt"

    @property
    def learned(self) -> tuple[Path, ...]:
        """The flights that this cell is trained on, before its pattern."""
        return self.simulated if self.cell.simulated else self.logs

    def settled(self) -> tuple[ModelConfig, Recipe]:
        """Configuration and recipe of the training. Raises RequestError for invalid values."""
        cell = self.cell
        return settled(
            TrainOptions(
                logs=self.learned,
                vehicle="",
                model=cell.model,
                out=self.model_file,
                recipe=self.recipe,
                config=cell.config,
                recipe_overrides=cell.recipe,
                ensemble=1,
            )
        )

    @property
    def fingerprint(self) -> str:
        """Hash of everything that decides the result, of files their content; without names and the study.

        Raises RequestError for a missing file.
        """
        cell, mapping = self.cell, () if self.mapping is None else (self.mapping,)
        files = [[file_hash(path) for path in paths] for paths in (self.learned, self.tests, mapping)]
        varied = cell.model, cell.seed, cell.prior, cell.flights, cell.hide_motors
        return hashlib.sha256(msgspec.json.encode([varied, self.settled(), files, self.vehicle_text])).hexdigest()


def file_hash(path: Path) -> str:
    """sha256 of a file. Raises RequestError for one that cannot be read."""
    try:
        stamp = path.stat()
        return _hash_of(path, stamp.st_mtime_ns, stamp.st_size)
    except OSError as error:
        raise RequestError(f"cannot read {path}: {error.strerror or error}. Give logs that are there.") from error


@lru_cache(maxsize=4096)
def _hash_of(path: Path, _changed: int, _size: int) -> str:
    """Hash of a file, read once while its time stamp and size stay the same; a hundred cells share their files."""
    return sha256(path)


def finished(work: CellWork) -> CellResult | None:
    """The result of a cell, None while it is not finished. Raises RequestError for a file of another sweep."""
    try:
        result = decode_json(work.result_file.read_bytes(), CellResult)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError) as error:
        raise RequestError(
            f"{work.result_file} is no cell of a sweep: {described(error)}. Delete it, or give another --out."
        ) from error
    if result.fingerprint != work.fingerprint:
        raise RequestError(
            f"{work.result_file} is of another sweep: its flights, vehicle, options or recipe differ. Give the same "
            "command as before, or another --out."
        )
    return msgspec.structs.replace(result, cell=work.cell)


def finished_cells(works: Sequence[CellWork]) -> Iterator[tuple[int, CellResult]]:
    """(place, result) of the cells that are finished. Raises RequestError for a folder of another sweep."""
    for place, work in enumerate(works):
        result = finished(work)
        if result is not None:
            yield place, result


def failure(work: CellWork) -> FailedCell | None:
    """The failure of a cell's last attempt, None without one or with a damaged file."""
    try:
        return decode_json(work.failure_file.read_bytes(), FailedCell)
    except (OSError, msgspec.MsgspecError):
        return None
