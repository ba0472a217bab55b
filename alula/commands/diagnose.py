"""`alula diagnose`: which physical effect is missing from the model."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from alula.diagnosis_input import Effects, HoldOut, Logs, Mapped, VehicleOption, read_input
from alula.output import write_json

if TYPE_CHECKING:
    from diagnosis.diagnose import Findings


def diagnose(
    logs: Logs,
    vehicle: VehicleOption,
    hold_out: HoldOut = None,
    effects: Effects = None,
    mapping: Mapped = None,
    json: Annotated[Path | None, typer.Option(help="Write the verdict as JSON; - for standard output.")] = None,
) -> None:
    """Name the physical effect that is missing from a vehicle's model, or say that the model explains the flights."""
    dataset, read, catalogue = read_input(logs, vehicle, hold_out, effects, mapping)
    from diagnosis import diagnose as room

    findings = room.diagnose(dataset, read, catalogue)
    if json is not None:
        write_json(findings.diagnosis, json)
    if json != Path("-"):
        _print(findings, Console(file=sys.stdout))


def _print(findings: Findings, console: Console) -> None:
    from diagnosis.report import sentence

    diagnosis = findings.diagnosis
    console.print(f"{diagnosis.verdict}: {sentence(diagnosis)}", highlight=False)
    for note in findings.notes:
        console.print(f"note: {note}", highlight=False)
    table = Table("channel", title="RMS on held-out flights", title_justify="left")
    for heading in ("before", "after", "noise floor", "unit"):
        table.add_column(heading, justify="right")
    for kind, error in diagnosis.channels.items():
        figures = (error.before, error.after, error.floor)
        table.add_row(kind, *(f"{value:.4g}" for value in figures), error.unit)
    console.print(table)
    for cell in diagnosis.fails_where:
        console.print(
            f"fails at {cell.regime} from {cell.low:g} to {cell.high:g}: {cell.channel} {cell.rms_over_floor:g} times "
            "its floor",
            highlight=False,
        )
    if diagnosis.not_excited:
        console.print(f"not excited, so neither there nor absent: {', '.join(diagnosis.not_excited)}", highlight=False)
    console.print(f"next flight: {diagnosis.next_flight}", highlight=False)
