"""The logs of a fleet's folder, and the vehicle of each."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from dynamics.errors import RequestError
from dynamics.trust import require_approved
from dynamics.vehicle_file import effect_files_in, find_vehicle, parse_vehicle, vehicle_text
from dynamics.vehicle_folder import vehicle_files_in
from flights.reading import logs_below

VEHICLE = "vehicle.toml"
NO_LOGS = frozenset((
    ".toml", ".md", ".json", ".jsonl", ".html", ".pdf", ".png", ".svg", ".jpg", ".yaml", ".yml", ".py", ".part",
))  # fmt: skip


@dataclass(frozen=True)
class FleetVehicle:
    """A vehicle as workers get it.

    name: of the vehicle.
    file: its path in the fleet's folder, or as it was requested for all logs.
    text: of its file.
    digest: hash of the text and of the effect files that it names.
    """

    name: str
    file: str
    text: str
    digest: str


@dataclass(frozen=True)
class FleetLog:
    """A log of the folder.

    name: its path in the folder, with slashes.
    vehicle: None where there is none for it; `error` has the reason then.
    """

    path: Path
    name: str
    vehicle: FleetVehicle | None
    error: str = ""


def find_fleet(
    folder: Path, vehicle: str | Path | None, *, effect_files: Sequence[Path] = (), without: Path | None = None
) -> list[FleetLog]:
    """The logs below a folder with their vehicles, in the order of their names.

    vehicle: of all logs; None for the nearest `vehicle.toml`, or the only vehicle file of a folder, at or above each
        log inside of the folder.
    without: a folder that holds no logs, that of the results.

    Raises RequestError for a folder without logs, one that cannot be read, or a vehicle that cannot be used.
    """
    if not folder.is_dir():
        raise RequestError(f"{folder} is no folder. Give a folder of logs: alula diagnose --fleet FOLDER.")
    of_all = None if vehicle is None else read_fleet_vehicle(find_vehicle(vehicle), str(vehicle), effect_files)
    paths = _log_paths(folder, without)
    if not paths:
        raise RequestError(f"{folder}: no log there. Give a folder with logs in it or below it.")

    @cache
    def nearest(place: Path) -> FleetVehicle | None:
        """The vehicle of the logs in a folder. Raises RequestError."""
        file = vehicle_file_in(place)
        if file is not None:
            return read_fleet_vehicle(file, file.relative_to(folder).as_posix(), effect_files)
        return None if place == folder else nearest(place.parent)

    logs = []
    for path in paths:
        name = path.name if path == folder else path.relative_to(folder).as_posix()
        error, own = "", of_all
        if own is None:
            try:
                own = nearest(folder if path == folder else path.parent)
                error = "" if own else no_vehicle(folder)
            except RequestError as problem:
                error = str(problem)
        logs.append(FleetLog(path, name, own, error))
    return logs


def no_vehicle(folder: Path) -> str:
    """Advice for a log without a vehicle."""
    return (
        f"no {VEHICLE} at or above this log inside of {folder}. Put one there (alula vehicle new, alula vehicle "
        "from-log), or give --vehicle for all logs."
    )


def vehicle_file_in(place: Path) -> Path | None:
    """The vehicle file of a folder: `vehicle.toml`, or the only TOML file that describes a vehicle.

    Raises RequestError where there are several.
    """
    if (place / VEHICLE).is_file():
        return place / VEHICLE
    files = vehicle_files_in(place)
    if len(files) > 1:
        names = ", ".join(path.name for path in files[:4])
        raise RequestError(f"{place} holds {len(files)} vehicle files ({names}). Name the one to use {VEHICLE}.")
    return files[0] if files else None


def read_fleet_vehicle(path: Path, label: str, effect_files: Sequence[Path] = ()) -> FleetVehicle:
    """A vehicle file, checked. label: what it is called in the results. Raises RequestError."""
    text = vehicle_text(path, effect_files=effect_files)
    require_approved(effect_files_in(text), carrier=path)
    try:
        vehicle = parse_vehicle(text)
    except RequestError as error:
        raise RequestError(f"{path}: {error}") from error
    return FleetVehicle(vehicle.name, label, text, hashlib.sha256(text.encode()).hexdigest())


def _log_paths(folder: Path, without: Path | None) -> list[Path]:
    """Files that may be logs; a tlog beside a recording of the same name is the same flight."""
    try:
        paths = list(logs_below(folder))
    except OSError as error:
        raise RequestError(
            f"cannot read the folder {error.filename or folder}: {error.strerror or error}. Give one that can be read."
        ) from error
    results = None if without is None else without.resolve()
    return [
        path
        for path in paths
        if path.suffix.lower() not in NO_LOGS
        and not (path.suffix == ".tlog" and path.with_suffix(".mcap").exists())
        and not (results is not None and path.resolve().is_relative_to(results))
    ]
