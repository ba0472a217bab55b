"""`alula add`: fits effects, evaluates them on held-out flights, writes the next version of the vehicle file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

import alula
from alula.cli.console import Console
from alula.cli.intake import vehicle_of_logs
from alula.cli.options import Effects, HoldOut, Mapping, OneFlight, Pose, RecordedSystem, VehicleOption
from alula.cli.output import print_next
from alula.cli.progress import stage_bar
from alula.cli.tables import before_and_after, open_loop_table
from dynamics.effects import CATALOGUE
from dynamics.errors import RequestError
from dynamics.files import STANDARD_OUTPUT, write_answer

if TYPE_CHECKING:
    from alula.api.results import AdditionResult, FlightAdditionResult
    from diagnosis.addition import Addition
    from diagnosis.estimation.fitted import ParameterEstimate
    from diagnosis.flight_addition import FlightAdditionReport
    from diagnosis.report import ParameterValue

ARGUMENTS_HELP = (
    "Effect of the catalogue, then logs of one vehicle in any format or folders of them. Without an effect, "
    "all that the diagnosis names are added. The first argument is a log where there is such a file, or where it "
    "contains a dot or a slash; write ./mass for a log with the name of an effect."
)


def add(
    arguments: Annotated[list[str], typer.Argument(help=ARGUMENTS_HELP, metavar="[EFFECT] LOG...")],
    vehicle: VehicleOption = None,
    hold_out: HoldOut = None,
    effects: Effects = None,
    mapping: Mapping = None,
    system: RecordedSystem = None,
    pose: Pose = None,
    one_flight: OneFlight = False,
    rotor: Annotated[int | None, typer.Option(min=0, help="Rotor of an effect; by default the best fit.")] = None,
    from_flight: Annotated[
        bool,
        typer.Option(
            "--from-flight",
            help="Add what the model followed in flight, from one recording of `fly --adapt shadow` or `on` with this "
            "vehicle (or a folder for its newest one), instead of fitting.",
        ),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="File to write instead of the next version.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write the addition as JSON; - for standard output.")] = None,
) -> None:
    """Fit an effect, or all that are missing, and write the next vehicle file, if held-out flights bear it out."""
    effect, logs = _effect_and_logs(arguments)
    vehicle = vehicle_of_logs(logs, vehicle, mapping)
    if from_flight:
        _refuse_from_flight({"--hold-out": hold_out, "--mapping": mapping, "--rotor": rotor})
        _add_from_flight(effect, logs, vehicle, effects, pose, out, json)
        return
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
    _write(result, vehicle, out, json, lambda console: _print(result.details, console))


def _refuse_from_flight(values: dict[str, object]) -> None:
    """Raise RequestError for what only a fit has."""
    if used := [name for name, value in values.items() if value is not None]:
        raise RequestError(f"{', '.join(used)} with --from-flight, which fits nothing. Leave it out.")


def _add_from_flight(
    effect: str | None,
    logs: list[Path],
    vehicle: str,
    effects: list[Path] | None,
    pose: str | None,
    out: Path | None,
    json: Path | None,
) -> None:
    if len(logs) != 1:
        raise RequestError(f"--from-flight takes one recording, not {len(logs)}. Give the one that flew.")
    with stage_bar() as progress:
        result = alula.add_from_flight(
            logs[0], vehicle, effect, effect_files=effects or (), pose=pose, progress=progress
        )
    _write(result, vehicle, out, json, lambda console: _print_from_flight(result.report, console))


def _write(
    result: AdditionResult | FlightAdditionResult,
    vehicle: str,
    out: Path | None,
    json: Path | None,
    show: Callable[[Console], None],
) -> None:
    """Write the vehicle file and the JSON, and show the rest."""
    path = result.write_next_version(vehicle) if out is None else result.write(out)
    if json is not None:
        write_answer(msgspec.structs.replace(result.report, vehicle=str(path)), json)
    if json != STANDARD_OUTPUT:
        console = Console()
        show(console)
        console.print(f"written: {path}", highlight=False)
        print_next("fly", "--vehicle", path, "--reference", "Lemniscate", "--record", "recordings")


def _effect_and_logs(arguments: list[str]) -> tuple[str | None, list[Path]]:
    """The effect, None where the first argument is a log, and the logs."""
    first = arguments[0]
    is_log = first not in CATALOGUE and (Path(first).exists() or "." in first or "/" in first)
    effect, logs = (None, arguments) if is_log else (first, arguments[1:])
    return effect, [Path(log) for log in logs]


def _print_from_flight(report: FlightAdditionReport, console: Console) -> None:
    from diagnosis.flight_addition import left_out_sentence

    for key, parameters in report.parameters.items():
        for name, value in parameters.items():
            _print_value(f"{key}.{name}", value, console)
    for left_out in report.left_out:
        console.print(f"left out: {left_out_sentence(left_out)}", highlight=False)
    for line in before_and_after(report.channels, "in that flight"):
        console.print(line, highlight=False)
    for note in report.notes:
        console.print(f"note: {note}", highlight=False)


def _print_value(name: str, estimate: ParameterEstimate | ParameterValue, console: Console) -> None:
    interval = f"{estimate.value:.5g} ± {1.96 * estimate.std:.2g} {estimate.unit}"
    console.print(f"{name} = {interval}", highlight=False)


def _print(addition: Addition, console: Console) -> None:
    for (key, name), estimate in addition.estimates.items():
        _print_value(f"{key}.{name}", estimate, console)
    for line in before_and_after(addition.channels):
        console.print(line, highlight=False)
    if addition.open_loop[0]:
        console.print(open_loop_table(*addition.open_loop))
    console.print("values and intervals are the likelihood's; errors are those of held-out flights", highlight=False)
    for note in addition.notes:
        console.print(f"note: {note}", highlight=False)
