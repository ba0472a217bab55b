"""`alula compare`: model against measurement, per channel and regime."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from alula.cli.logs_input import Effects, Logs, Mapped, Page, VehicleOption, read_input
from dynamics.files import write_json
from studio.provenance import origin

if TYPE_CHECKING:
    from diagnosis.comparison import Comparison


def compare(
    logs: Logs,
    vehicle: VehicleOption,
    effects: Effects = None,
    mapping: Mapped = None,
    json: Annotated[Path | None, typer.Option(help="Write the comparison as JSON; - for standard output.")] = None,
    html: Page = None,
) -> None:
    """Compare a vehicle's model with flights: error of each channel over its noise floor, and where it fails."""
    dataset, read, catalogue = read_input(logs, vehicle, None, effects, mapping)
    from diagnosis import comparison as room

    compared = room.compare(dataset, read, catalogue)
    found = compared.comparison
    if json is not None:
        write_json(found, json)
    if html is not None:
        from studio.page import write_page
        from studio.report import comparison_page

        write_page(comparison_page(compared, dataset, read, origin=origin(dataset.hashes)), html)
    if json != Path("-"):
        _print(found, Console())


def _print(found: Comparison, console: Console) -> None:
    table = Table("channel", title="measured less modelled", title_justify="left")
    for heading in ("RMS", "noise floor", "over floor", "unit"):
        table.add_column(heading, justify="right")
    for axis in found.axes:
        figures = (axis.rms, axis.floor, axis.rms / axis.floor)
        table.add_row(f"{axis.kind} {axis.axis}", *(f"{value:.3g}" for value in figures), axis.unit)
    console.print(table)
    ahead = Table("open loop, s", title="prediction error, RMS", title_justify="left")
    for heading in ("position m", "velocity m/s", "attitude rad", "rate rad/s"):
        ahead.add_column(heading, justify="right")
    for error in found.open_loop:
        figures_ahead = (error.position, error.velocity, error.attitude, error.rate)
        ahead.add_row(f"{error.horizon:g}", *(f"{value:.3g}" for value in figures_ahead))
    if found.open_loop:
        console.print(ahead)
    for cell in found.fails_where:
        where = f"{cell.regime} from {cell.low:g} to {cell.high:g}"
        console.print(f"fails at {where}: {cell.channel} {cell.rms_over_floor:g} times its floor", highlight=False)
    worst = found.worst
    console.print(
        f"worst two seconds: {worst.flight} from {worst.start:g} s, {worst.rms_over_floor:g} times the floor",
        highlight=False,
    )
    for note in found.notes:
        console.print(f"note: {note}", highlight=False)
