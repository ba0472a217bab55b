"""`alula diagnose`: which physical effect is missing from the model."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from alula.cli.logs_input import Effects, HoldOut, Logs, Mapped, Page, VehicleOption, read_input, require_workbench
from dynamics.errors import RequestError
from dynamics.files import write_json
from dynamics.vehicle_file import read_vehicle
from studio.provenance import origin
from vehicles import vehicle_path

if TYPE_CHECKING:
    from diagnosis.diagnose import Findings
    from diagnosis.hover_trim import TrimComparison

Normal = Annotated[
    list[Path] | None,
    typer.Option(help="Normal flight of this vehicle, a folder or 'pattern' of such: compare the hover. Repeatable."),
]


def diagnose(
    logs: Logs,
    vehicle: VehicleOption,
    hold_out: HoldOut = None,
    effects: Effects = None,
    mapping: Mapped = None,
    normal: Normal = None,
    json: Annotated[Path | None, typer.Option(help="Write the verdict as JSON; - for standard output.")] = None,
    html: Page = None,
) -> None:
    """Name the physical effect that is missing from a vehicle's model, or say that the model explains the flights.

    With --normal: whether a rotor works harder in hover than in normal flights of the same vehicle, which needs no more
    than motor commands.
    """
    if normal:
        _compare_trim(logs, normal, vehicle, mapping, json)
        return
    dataset, read, catalogue = read_input(logs, vehicle, hold_out, effects, mapping)
    from diagnosis import diagnose as room

    findings = room.diagnose(dataset, read, catalogue)
    if json is not None:
        write_json(findings.diagnosis, json)
    if html is not None:
        from studio.page import write_page
        from studio.report import add_command, diagnosis_page

        add = add_command(findings.diagnosis, logs, vehicle, hold_out)
        write_page(diagnosis_page(findings, dataset, read, origin=origin(dataset.hashes, add)), html)
    if json != Path("-"):
        _print(findings, Console(file=sys.stdout))


def _compare_trim(logs: list[Path], normal: list[Path], vehicle: str, mapping: Path | None, json: Path | None) -> None:
    require_workbench()
    from diagnosis.hover_trim import read_trim

    usual = [log for entry in normal for log in _logs_of(entry)]
    compared = read_trim(logs, usual, read_vehicle(vehicle_path(vehicle)), mapping)
    if json is not None:
        write_json(compared, json)
    if json != Path("-"):
        _print_trim(compared, Console(file=sys.stdout))


def _logs_of(entry: Path) -> list[Path]:
    """The logs that a path, a folder or a pattern of names stands for. Raises RequestError where there are none."""
    if entry.is_dir():
        found = sorted(path for path in entry.iterdir() if path.is_file())
    elif any(letter in entry.name for letter in "*?[") and not entry.exists():
        found = sorted(entry.parent.glob(entry.name))
    else:
        found = [entry]
    if not found:
        raise RequestError(f"--normal {entry}: no log there. Give logs, a folder of logs, or a pattern in quotes.")
    return found


def _print_trim(compared: TrimComparison, console: Console) -> None:
    from diagnosis.hover_trim import trim_sentence

    console.print(f"{compared.verdict}: {trim_sentence(compared)}", highlight=False)
    for note in compared.notes:
        console.print(f"note: {note}", highlight=False)
    table = Table("rotor", title="share of the commands in hover, 1 for the mean rotor", title_justify="left")
    for heading in ("normal", "now", "still usual up to"):
        table.add_column(heading, justify="right")
    for rotor in compared.rotors:
        table.add_row(str(rotor.rotor), *(f"{value:.3f}" for value in (rotor.normal, rotor.now, rotor.limit)))
    console.print(table)
    console.print(f"next flight: {compared.next_flight}", highlight=False)


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
