"""`alula prove`: two versions of a vehicle file on flights that nothing was fitted to, and in the controller."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import alula
from alula.cli.console import Console
from alula.cli.intake import vehicle_of_logs
from alula.cli.options import Effects, HoldOut, Logs, Mapping, Pose, RecordedSystem, VehicleOption
from alula.cli.output import options, print_next
from alula.cli.progress import stage_bar
from alula.cli.tables import before_and_after, open_loop_table
from dynamics.files import STANDARD_OUTPUT

if TYPE_CHECKING:
    from alula.api.results import ProofResult


def prove(
    logs: Logs,
    before: Annotated[str, typer.Option(help="The version to compare with, as --vehicle.")],
    vehicle: VehicleOption = None,
    fly: Annotated[
        str | None,
        typer.Option(
            help="Also fly a reference, such as Lemniscate, in simulation: on a vehicle with the effects of --vehicle, "
            "with either version in the controller.",
            metavar="REFERENCE",
        ),
    ] = None,
    hold_out: HoldOut = None,
    effects: Effects = None,
    mapping: Mapping = None,
    system: RecordedSystem = None,
    pose: Pose = None,
    json: Annotated[Path | None, typer.Option(help="Write the errors as JSON; - for standard output.")] = None,
) -> None:
    """Compare two versions of a vehicle file on held-out flights: errors one step ahead and in open loop."""
    vehicle = vehicle_of_logs(logs, vehicle, mapping)
    with stage_bar() as progress:
        result = alula.prove(
            logs,
            vehicle,
            before,
            fly=fly,
            hold_out=hold_out,
            effect_files=effects or (),
            mapping=mapping,
            pose=pose,
            progress=progress,
        )
    if json is not None:
        result.write_json(json)
    if json != STANDARD_OUTPUT:
        _print(result, Console())
        own = options([("--effects", effects)])
        print_next("fly", "--vehicle", vehicle, *own, "--reference", fly or "Lemniscate", "--record", "recordings")


def _print(result: ProofResult, console: Console) -> None:
    report, flown = result.report, result.flown
    console.print(f"held out: {', '.join(report.held_out)}", highlight=False)
    for line in before_and_after(report.channels):
        console.print(line, highlight=False)
    if report.open_loop.before:
        console.print(open_loop_table(report.open_loop.before, report.open_loop.after))
    if flown is None:
        return
    figures = [f"{100 * flight.rmse:.1f} cm" for flight in (flown.before, flown.after)]
    console.print(f"{flown.reference} in simulation, RMS position error: {' -> '.join(figures)}", highlight=False)
    for name, flight in (("before", flown.before), ("after", flown.after)):
        if flight.aborted:
            console.print(f"{name}: ended early, {flight.aborted}", highlight=False)
