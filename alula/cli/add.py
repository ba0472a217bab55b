"""`alula add`: fits effects, evaluates them on held-out flights, writes the next version of the vehicle file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer
from rich.console import Console

import alula
from alula.cli.options import Effects, HoldOut, Mapping, Pose, VehicleOption
from alula.cli.output import print_next
from alula.cli.progress import stage_bar
from alula.cli.tables import before_and_after, open_loop_table
from dynamics.effects import CATALOGUE
from dynamics.files import STANDARD_OUTPUT, write_json

if TYPE_CHECKING:
    from diagnosis.addition import Addition

ARGUMENTS_HELP = (
    "Effect of the catalogue, then logs of one vehicle in any format or folders of them. Without an effect, "
    "all that the diagnosis names are added. The first argument is a log where there is such a file, or where it "
    "contains a dot or a slash; write ./mass for a log with the name of an effect."
)


def add(
    arguments: Annotated[list[str], typer.Argument(help=ARGUMENTS_HELP, metavar="[EFFECT] LOG...")],
    vehicle: VehicleOption,
    hold_out: HoldOut = None,
    effects: Effects = None,
    mapping: Mapping = None,
    pose: Pose = None,
    rotor: Annotated[int | None, typer.Option(min=0, help="Rotor of an effect; by default the best fit.")] = None,
    out: Annotated[Path | None, typer.Option(help="File to write instead of the next version.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write the addition as JSON; - for standard output.")] = None,
) -> None:
    """Fit an effect, or all that are missing, and write the next vehicle file, if held-out flights bear it out."""
    effect, logs = _effect_and_logs(arguments)
    with stage_bar() as progress:
        result = alula.add_effect(
            logs,
            vehicle,
            effect,
            rotor=rotor,
            hold_out=hold_out,
            effect_files=effects or (),
            mapping=mapping,
            pose=pose,
            progress=progress,
        )
    path = result.write_next_version(vehicle) if out is None else result.write(out)
    if json is not None:
        write_json(msgspec.structs.replace(result.report, vehicle=str(path)), json)
    if json != STANDARD_OUTPUT:
        _print(result.details, path, Console())
        print_next("fly", "--vehicle", path, "--reference", "Lemniscate", "--record", "recordings")


def _effect_and_logs(arguments: list[str]) -> tuple[str | None, list[Path]]:
    """The effect, None where the first argument is a log, and the logs."""
    first = arguments[0]
    is_log = first not in CATALOGUE and (Path(first).exists() or "." in first or "/" in first)
    effect, logs = (None, arguments) if is_log else (first, arguments[1:])
    return effect, [Path(log) for log in logs]


def _print(addition: Addition, path: Path, console: Console) -> None:
    for (key, name), estimate in addition.estimates.items():
        interval = f"{estimate.value:.5g} ± {1.96 * estimate.std:.2g} {estimate.unit}"
        console.print(f"{key}.{name} = {interval}", highlight=False)
    for line in before_and_after(addition.channels):
        console.print(line, highlight=False)
    if addition.open_loop[0]:
        console.print(open_loop_table(*addition.open_loop))
    how = "output error, over simulated half seconds" if addition.by_output_error else "equation error"
    console.print(f"fitted by {how}", highlight=False)
    for note in addition.notes:
        console.print(f"note: {note}", highlight=False)
    console.print(f"written: {path}", highlight=False)
