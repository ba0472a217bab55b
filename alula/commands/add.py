"""`alula add`: fit an effect, judge it on held-out flights, write the next version of the vehicle file."""

from __future__ import annotations

import datetime
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from alula.diagnosis_input import Effects, HoldOut, Logs, Mapped, VehicleOption, read_input
from vehicles import vehicle_path


def add(
    effect: Annotated[str, typer.Argument(help="Effect of the catalogue, as `alula diagnose` names it.")],
    logs: Logs,
    vehicle: VehicleOption,
    hold_out: HoldOut = None,
    effects: Effects = None,
    mapping: Mapped = None,
    rotor: Annotated[int | None, typer.Option(min=0, help="Rotor of an effect of one; else the best one.")] = None,
    out: Annotated[Path | None, typer.Option(help="File to write instead of the next version beside the old.")] = None,
) -> None:
    """Fit an effect and write the next vehicle file, unless the error on held-out flights does not fall."""
    dataset, read, catalogue = read_input(logs, vehicle, hold_out, effects, mapping)
    from diagnosis.addition import add_effect, write_next_version
    from dynamics.vehicle_file import write_vehicle

    command = shlex.join(["alula", *sys.argv[1:]])
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    added = add_effect(effect, dataset, read, catalogue, date=today, command=command, rotor=rotor)
    path = out
    if path is None:
        path = write_next_version(added.vehicle, vehicle_path(vehicle))
    else:
        write_vehicle(added.vehicle, path)
    console = Console()
    for (key, name), estimate in added.estimates.items():
        interval = f"{estimate.value:.5g} ± {1.96 * estimate.std:.2g} {estimate.unit}"
        console.print(f"{key}.{name} = {interval}", highlight=False)
    for kind, error in added.channels.items():
        console.print(
            f"{kind}, held out: {error.before:.4g} -> {error.after:.4g} {error.unit}, floor {error.floor:.4g}",
            highlight=False,
        )
    console.print(f"written: {path}", highlight=False)
