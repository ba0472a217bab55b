"""`alula diagnose`: names the physical effect that the model lacks."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

import alula
from alula.cli.console import Console
from alula.cli.fleet import FLEET, diagnose_fleet
from alula.cli.intake import vehicle_of_logs
from alula.cli.options import Effects, Figures, HoldOut, Mapping, OneFlight, Page, Pose, RecordedSystem
from alula.cli.output import options, print_next, print_written
from alula.cli.planning import planning_progress
from alula.cli.progress import stage_bar
from dynamics.errors import RequestError
from dynamics.files import STANDARD_OUTPUT, write_answer
from dynamics.references.catalogue import IDENTIFY

if TYPE_CHECKING:
    from alula.api.results import DiagnosisResult
    from diagnosis.hover_trim import TrimComparison

Normal = Annotated[
    list[Path] | None,
    typer.Option(help="Normal flight of this vehicle, or a folder or 'pattern' of them: compares hover. Repeatable."),
]


def diagnose(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(help="Logs of one vehicle in any format, or folders of them.", metavar="LOG..."),
    ] = None,
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", help="Vehicle file (TOML), or the name of a bundled one.")
    ] = None,
    hold_out: HoldOut = None,
    effects: Effects = None,
    mapping: Mapping = None,
    system: RecordedSystem = None,
    pose: Pose = None,
    one_flight: OneFlight = False,
    normal: Normal = None,
    json: Annotated[Path | None, typer.Option(help="Write the verdict as JSON; - for standard output.")] = None,
    html: Page = None,
    figures: Figures = None,
    next_flight: Annotated[
        Path | None,
        typer.Option(help="Plan the flight for the effects that are open, and write it to this file (CSV) for `fly`."),
    ] = None,
    fleet: Annotated[
        Path | None,
        typer.Option(
            help="Folder of logs of many vehicles: diagnoses each log by itself, with --vehicle or the nearest "
            "vehicle.toml at or above it.",
            rich_help_panel=FLEET,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the results, where a stopped run continues; FOLDER.fleet by default.",
            rich_help_panel=FLEET,
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; one for every core by default.", rich_help_panel=FLEET)
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Address of a Dask scheduler (tcp://host:port); its workers need the same folders.",
            rich_help_panel=FLEET,
        ),
    ] = None,
) -> None:
    """Name the physical effect that is missing from a vehicle's model, or report that the model explains the flights.

    With --normal: whether a rotor works harder in hover than in normal flights of the same vehicle. Motor commands are
    enough for that. With --fleet: every log of a folder, one JSON line each, and what changes over their dates.
    """
    if fleet is not None:
        _refuse_beside_fleet(
            {
                "LOG": logs,
                "--hold-out": hold_out,
                "--normal": normal,
                "--one-flight": one_flight,
                "--next-flight": next_flight,
                "--figures": figures,
            }
        )
        diagnose_fleet(fleet, vehicle, effects, mapping, pose, json, html, out, workers, scheduler)
        return
    _refuse_without_fleet({"--out": out, "--workers": workers, "--scheduler": scheduler})
    if not logs:
        raise RequestError("a diagnosis needs logs: alula diagnose LOG... --vehicle V.toml, or a folder with --fleet.")
    vehicle = vehicle_of_logs(logs, vehicle, mapping)
    if normal and one_flight:
        raise RequestError("--one-flight with --normal, which compares flights. Leave one of them out.")
    if normal:
        _compare_hover(logs, normal, vehicle, mapping, json)
        return
    with stage_bar() as progress:
        result = alula.diagnose(
            logs,
            vehicle,
            hold_out=hold_out,
            effect_files=effects or (),
            mapping=mapping,
            pose=pose,
            progress=progress,
        )
    if json is not None:
        result.write_json(json)
    shared: dict[str, Any] = {"--hold-out": hold_out, "--effects": effects, "--mapping": mapping, "--pose": pose}
    if one_flight:
        shared["--one-flight"] = True
    if system is not None:
        shared["--system"] = str(system)
    if html is not None:
        from studio.pages.report import add_command

        adding = add_command(result.report, logs, vehicle, shared, result.details.noise.catalogue)
        result.write_html(html, add_command=adding)
    if figures is not None:
        print_written(result.write_pictures(figures), figures)
    if next_flight is not None:
        _write_next_flight(result, next_flight)
    if json != STANDARD_OUTPUT:
        _print(result, Console(file=sys.stdout))
        following = _following(result, logs, vehicle, tuple(shared.items()))
        print_next(*(following if next_flight is None else _flying(vehicle, next_flight, effects)))


def _refuse_beside_fleet(values: dict[str, object]) -> None:
    """Raise RequestError for what only the diagnosis of one vehicle's flights has."""
    if used := [name for name, value in values.items() if value]:
        raise RequestError(f"{', '.join(used)} with --fleet, which diagnoses every log of its folder. Leave it out.")


def _refuse_without_fleet(values: dict[str, object]) -> None:
    """Raise RequestError for what only a fleet has."""
    if used := [name for name, value in values.items() if value is not None]:
        raise RequestError(f"{', '.join(used)} without --fleet FOLDER. Give the folder, or leave it out.")


def _write_next_flight(result: DiagnosisResult, path: Path) -> None:
    with planning_progress(Console(stderr=True)) as progress:
        flight = alula.plan_flight(result.vehicle, result.report.next_reference or IDENTIFY, progress=progress)
    flight.write_csv(path)


def _flying(vehicle: str, reference: object, effects: list[Path] | None) -> list[object]:
    own = options([("--effects", effects)])
    return ["fly", "--vehicle", vehicle, *own, "--reference", reference, "--record", "recordings"]


def _following(
    result: DiagnosisResult, logs: list[Path], vehicle: str, shared: Sequence[tuple[str, Any]]
) -> list[object]:
    """Next command: add what a vehicle file can hold, fly for what is open, look where nothing fits."""
    catalogue, report = result.details.noise.catalogue, result.report
    own_effects = next(value for name, value in shared if name == "--effects")
    if report.verdict == "ambiguous" and report.next_reference:
        return _flying(vehicle, report.next_reference, own_effects)
    if any(not catalogue[effect.name].stochastic for effect in report.effects):
        return ["add", *logs, "--vehicle", vehicle, *options(shared)]
    if report.verdict == "unknown":
        own = options((name, value) for name, value in shared if name != "--hold-out")
        return ["compare", *logs, "--vehicle", vehicle, *own, "--html", "comparison.html"]
    return _flying(vehicle, report.next_reference or "Lemniscate", own_effects)


def _compare_hover(logs: list[Path], normal: list[Path], vehicle: str, mapping: Path | None, json: Path | None) -> None:
    comparison = alula.compare_hover(logs, normal, vehicle, mapping=mapping)
    if json is not None:
        write_answer(comparison, json)
    if json != STANDARD_OUTPUT:
        _print_hover(comparison, Console(file=sys.stdout))
        print_next("diagnose", *logs, "--vehicle", vehicle, *options([("--mapping", mapping)]))


def _print_hover(comparison: TrimComparison, console: Console) -> None:
    from diagnosis.hover_trim import trim_sentence

    console.print(f"{comparison.verdict}: {trim_sentence(comparison)}", highlight=False)
    for note in comparison.notes:
        console.print(f"note: {note}", highlight=False)
    table = Table("rotor", title="share of the commands in hover, 1 for the mean rotor", title_justify="left")
    for heading in ("normal", "now", "normal up to"):
        table.add_column(heading, justify="right")
    for rotor in comparison.rotors:
        table.add_row(
            rotor.name.removeprefix("rotor "), *(f"{value:.3f}" for value in (rotor.normal, rotor.now, rotor.limit))
        )
    console.print(table)
    console.print(f"next flight: {comparison.next_flight}", highlight=False)


def _print(result: DiagnosisResult, console: Console) -> None:
    from diagnosis.models.channels import NAMES
    from diagnosis.report import (
        evidence_sentence,
        in_flight_sentence,
        leftover_sentence,
        refusal_sentence,
        score_sentence,
    )

    diagnosis = result.report
    console.print(f"{diagnosis.verdict}: {result.sentence}", highlight=False)
    for note in result.details.notes:
        console.print(f"note: {note}", highlight=False)
    table = Table("channel", title="RMS on held-out flights", title_justify="left")
    for heading in ("before", "after", "floor", "sensors", "unit"):
        table.add_column(heading, justify="right")
    for kind, error in diagnosis.channels.items():
        figures = (error.before, error.after, error.floor, error.sensors)
        table.add_row(NAMES[kind], *(f"{value:.4g}" for value in figures), error.unit)
    console.print(table)
    if diagnosis.held_out_score is not None:
        console.print(score_sentence(diagnosis.held_out_score), highlight=False)
    for cell in diagnosis.fails_where if diagnosis.verdict != "explained" else ():
        console.print(
            f"fails at {cell.regime} from {cell.low:g} to {cell.high:g}: {NAMES[cell.channel]} {cell.rms_over_floor:g} "
            "times its floor",
            highlight=False,
        )
    for left in diagnosis.leftover:
        console.print(f"left: {leftover_sentence(left)}. {evidence_sentence(left)}", highlight=False)
    for one in diagnosis.refused:
        console.print(
            f"{'a hint' if one.is_hint else 'not named'}: {refusal_sentence(one, diagnosis.rotors)}", highlight=False
        )
    for followed in diagnosis.in_flight:
        console.print(f"in flight: {in_flight_sentence(followed, diagnosis.rotors)}", highlight=False)
    if diagnosis.not_excited:
        console.print(
            f"not excited, so neither present nor absent: {', '.join(diagnosis.not_excited)}", highlight=False
        )
    console.print(f"next flight: {diagnosis.next_flight}", highlight=False)
