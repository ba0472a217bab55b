"""Arguments of the public functions, converted to the types of the packages behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from alula.workbench import workbench
from dynamics.errors import RequestError
from dynamics.progress import Progress, no_progress
from dynamics.recorded_vehicle import system_chosen

if TYPE_CHECKING:
    from diagnosis.data.dataset import Dataset
    from dynamics.effect import Effect
    from dynamics.vehicle import Vehicle
    from flights import Flight


def catalogue_with(effects: Sequence[str | Path]) -> Mapping[str, Effect]:
    """The catalogue and the effects of a user's files, tried on a bundled vehicle.

    Raises RequestError for a file that defines none.
    """
    from dynamics.effect_file import with_effects_of
    from dynamics.effect_source import read_effect_file
    from dynamics.effects import CATALOGUE
    from dynamics.trust import approve_given
    from dynamics.vehicle_file import read_vehicle
    from vehicles import FOLDER

    if not effects:
        return CATALOGUE
    approve_given(effects)
    return with_effects_of(map(read_effect_file, effects), read_vehicle(FOLDER / "arpl_250g.toml"))


def vehicle_of(vehicle: Vehicle | str | Path, effect_files: Sequence[str | Path] = ()) -> Vehicle:
    """A vehicle as it is, or read from its file, with further effect files, which are approved by being given.

    Raises RequestError for a file that cannot be used, or effects that are not approved.
    """
    from dynamics.trust import approve_given
    from dynamics.vehicle_file import find_vehicle, read_vehicle, with_added_files

    approve_given(effect_files)
    if isinstance(vehicle, (str, Path)):
        return read_vehicle(find_vehicle(vehicle), effect_files=effect_files)
    return with_added_files(vehicle, effect_files)


def log_paths(logs: str | Path | Sequence[str | Path], mapping: str | Path | None = None) -> list[Path]:
    """Logs as they are; every log below a folder and every match of a pattern, in the order of their names.

    A tlog beside a recording of the same name holds the same flight and is left out, and so are a folder's files that
    are no logs. mapping: column mapping (TOML) of tables. Raises RequestError for a folder or a pattern without logs.
    """
    return [p for log in ([logs] if isinstance(logs, (str, Path)) else logs) for p in _files(Path(log), mapping)]


def dataset_of(
    logs: Flight | str | Path | Sequence[Flight | str | Path],
    vehicle: Vehicle,
    hold_out: str | None,
    mapping: str | Path | None,
    pose: str | None = None,
    progress: Progress = no_progress,
    system: int | None = None,
) -> Dataset:
    """Flights, read where they are logs, divided into those to fit and those held out.

    Raises RequestError for logs that cannot be found or a mixture of logs and flights, DataError when they hold too
    little.
    """
    from diagnosis.data.dataset import make_dataset, read_dataset
    from flights import Flight
    from flights.pose_source import with_source

    items = list(logs) if isinstance(logs, Sequence) and not isinstance(logs, str) else [logs]
    flights = [item for item in items if isinstance(item, Flight)]
    paths = [item for item in items if not isinstance(item, Flight)]
    if flights and paths:
        raise RequestError("logs and flights are mixed. Give paths, or what `alula.read_flights` returned.")
    if flights:
        flights = [replace(f, metadata=with_source(f.metadata, pose)) for f in flights]
        return make_dataset(flights, vehicle, hold_out=hold_out)
    with system_chosen(system):
        return read_dataset(
            log_paths(paths, mapping), vehicle, hold_out=hold_out, mapping=mapping, pose=pose, progress=progress
        )


def _files(path: Path, mapping: str | Path | None) -> Sequence[Path]:
    others: tuple[Path, ...] = ()
    if path.is_dir():
        with workbench("reading logs"):
            from flights.folder import folder_content
        content = folder_content(path, mapping)
        logs, others = list(content.logs), content.others
    elif any(letter in path.name for letter in "*?[") and not path.exists():
        logs = sorted(path.parent.glob(path.name))
    else:
        logs = [path]
    if not logs:
        what = f", but {len(others)} other files ({names_of(others)})" if others else ""
        raise RequestError(f"{path}: no log there{what}. Give logs, a folder of logs, or a pattern in quotes.")
    return logs


def names_of(paths: Sequence[Path], shown: int = 6) -> str:
    """The names of some files, the first ones of many."""
    more = f", and {len(paths) - shown} more" if len(paths) > shown else ""
    return ", ".join(path.name for path in paths[:shown]) + more
