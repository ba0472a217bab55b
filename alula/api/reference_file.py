"""A planned flight as a file that can be flown."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from alula.api.planning import plan_flight
from dynamics.errors import RequestError
from dynamics.files import make_folder

if TYPE_CHECKING:
    from dynamics.vehicle import Vehicle

FILE = "identification_flight.csv"


@dataclass(frozen=True)
class PlannedReference:
    """A planned reference on the disk. text: what was planned, a few lines for a terminal."""

    file: str
    text: str


def planned_reference(
    request: str,
    vehicle: Vehicle | str | Path | None,
    *,
    effect_files: Sequence[str | Path] = (),
    duration: float | None = None,
    folder: str | Path | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> PlannedReference:
    """Plan a flight, and write its reference for `fly` where no file of the name is.

    vehicle: or the folder of a bundle. duration: of the request where it names none, s. folder: of the file.
    """
    from runtime.control.bundle import VEHICLE

    if vehicle is None:
        raise RequestError("nothing to plan for: give either --vehicle V.toml or --bundle B.")
    if isinstance(vehicle, (str, Path)) and (Path(vehicle) / VEHICLE).is_file():
        vehicle = Path(vehicle) / VEHICLE
    if duration is not None and "duration=" not in request:
        request = f"{request}{',' if ':' in request else ':'}duration={duration:g}"
    flight = plan_flight(vehicle, request, effect_files=effect_files, progress=progress)
    target = Path(folder or ".")
    if folder is not None:
        make_folder(target, advice="Give another one.")
    file = flight.write_csv(_unused(target / FILE))
    return PlannedReference(str(file), f"{flight.text}\nwritten to {file}")


def _unused(path: Path) -> Path:
    """The path, or the first with a number behind its name that is not there."""
    numbered = (path.with_stem(f"{path.stem}_{number}") for number in itertools.count(2))
    return path if not path.exists() else next(other for other in numbered if not other.exists())
