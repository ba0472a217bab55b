"""What compare, diagnose and add share: the options that say which flights and which vehicle, and reading them."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import util
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynamics.effect import Effect
from dynamics.effect_file import with_effects_of
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_file import read_vehicle
from vehicles import vehicle_path

if TYPE_CHECKING:
    from diagnosis.data.dataset import Dataset

Logs = Annotated[list[Path], typer.Argument(help="Logs of one vehicle, in any format.", metavar="LOG...")]
VehicleOption = Annotated[str, typer.Option("--vehicle", help="Vehicle file (TOML), or the name of one that is ours.")]
HoldOut = Annotated[
    str | None, typer.Option(help="File names to judge on, as a pattern; by default the last fifth of the flights.")
]
Effects = Annotated[list[Path] | None, typer.Option(help="Python file with effects of your own. Repeatable.")]
Page = Annotated[Path | None, typer.Option("--html", help="Write a page with all pictures, one file, to this path.")]
Mapped = Annotated[Path | None, typer.Option("--mapping", help="Column mapping (TOML) for CSV files of other tools.")]


def read_input(
    logs: list[Path], vehicle: str, hold_out: str | None, effects: list[Path] | None, mapping: Path | None
) -> tuple[Dataset, Vehicle, Mapping[str, Effect]]:
    """Flights, vehicle and catalogue. Raises RequestError or DataError for whatever cannot be used."""
    require_workbench()
    from diagnosis.data.dataset import read_dataset  # scipy, which the flight computer has not

    path = vehicle_path(vehicle)
    known = dict(CATALOGUE)
    if effects:
        from vehicles import FOLDER

        any_vehicle = read_vehicle(FOLDER / "arpl_250g.toml")  # to try the effects on before the file that may use them
        known = dict(with_effects_of(effects, any_vehicle))
    read = read_vehicle(path, catalogue=known)
    return read_dataset(list(logs), read, hold_out=hold_out, mapping=mapping), read, known


def require_workbench() -> None:
    """Raise RequestError where only the flight computer's install is."""
    missing = [name for name in ("scipy", "pyarrow") if util.find_spec(name) is None]
    if missing:
        raise RequestError(f"this needs {' and '.join(missing)}: pip install 'alula[workbench]' on the desk.")
