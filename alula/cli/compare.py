"""`alula compare`: compares model and measurement, by channel and regime."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

import alula
from alula.cli.console import Console
from alula.cli.intake import vehicle_of_logs
from alula.cli.options import Effects, Figures, Logs, Mapping, OneFlight, Page, Pose, RecordedSystem, VehicleOption
from alula.cli.output import options, print_next, print_written
from alula.cli.progress import stage_bar
from dynamics.files import STANDARD_OUTPUT

if TYPE_CHECKING:
    from diagnosis.comparison import Comparison


def compare(
    logs: Logs,
    vehicle: VehicleOption = None,
    trial: Annotated[
        str | None,
        typer.Option(
            "--with",
            help="An effect with values that the vehicle has for this comparison, such as rotor_drag:coefficient=2e-5, "
            "or weak_rotor:rotor=1,loss=0.1.",
            metavar="EFFECT",
        ),
    ] = None,
    effects: Effects = None,
    mapping: Mapping = None,
    system: RecordedSystem = None,
    pose: Pose = None,
    one_flight: OneFlight = False,
    json: Annotated[Path | None, typer.Option(help="Write the comparison as JSON; - for standard output.")] = None,
    html: Page = None,
    figures: Figures = None,
) -> None:
    """Compare a vehicle's model with flights: error of each channel over its noise floor, and where it is largest."""
    vehicle = vehicle_of_logs(logs, vehicle, mapping)
    with stage_bar() as progress:
        result = alula.compare(
            logs, vehicle, trial=trial, effect_files=effects or (), mapping=mapping, pose=pose, progress=progress
        )
    if json is not None:
        result.write_json(json)
    if html is not None:
        result.write_html(html)
    if figures is not None:
        print_written(result.write_pictures(figures), figures)
    if json != STANDARD_OUTPUT:
        _print(result.report, Console())
        shared: list[tuple[str, object]] = [("--effects", effects), ("--mapping", mapping), ("--pose", pose)]
        shared += [("--system", system), ("--one-flight", one_flight)]
        print_next("diagnose", *logs, "--vehicle", vehicle, *options(shared))


def _print(comparison: Comparison, console: Console) -> None:
    from diagnosis.models.channels import NAMES

    table = Table("channel", title="measured less modelled", title_justify="left")
    for heading in ("RMS", "floor", "over floor", "sensors", "unit"):
        table.add_column(heading, justify="right")
    for axis in comparison.axes:
        figures = (axis.rms, axis.floor, axis.rms / axis.floor, axis.sensors)
        table.add_row(f"{NAMES[axis.kind]} {axis.axis}", *(f"{value:.3g}" for value in figures), axis.unit)
    console.print(table)
    open_loop = Table("open loop, s", title="prediction error, RMS", title_justify="left")
    for heading in ("position m", "velocity m/s", "attitude rad", "rate rad/s"):
        open_loop.add_column(heading, justify="right")
    for error in comparison.open_loop:
        open_loop.add_row(f"{error.horizon:g}", *error.figures)
    if comparison.open_loop:
        console.print(open_loop)
    for cell in comparison.fails_where:
        where = f"{cell.regime} from {cell.low:g} to {cell.high:g}"
        console.print(
            f"fails at {where}: {NAMES[cell.channel]} {cell.rms_over_floor:g} times its floor", highlight=False
        )
    worst = comparison.worst
    console.print(
        f"worst two seconds: {worst.flight} from {worst.start:g} s, {worst.rms_over_floor:g} times the floor",
        highlight=False,
    )
    for note in comparison.notes:
        console.print(f"note: {note}", highlight=False)
