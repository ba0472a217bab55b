"""`alula diagnose --fleet`: every log of a folder by itself, and what changes from flight to flight."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

import alula
from alula.cli.console import Console
from alula.cli.output import options, print_next
from alula.cli.progress import counting_bar
from dynamics.errors import DataError
from dynamics.files import STANDARD_OUTPUT

if TYPE_CHECKING:
    from alula.api.results import FleetResult
    from studies.fleet.summary import FleetReport

FLEET = "A fleet"  # the panel of its options
SHOWN = 10  # rows of a table in a terminal
MONTH = 30.0  # days


def diagnose_fleet(
    folder: Path,
    vehicle: str | None,
    effects: list[Path] | None,
    mapping: Path | None,
    pose: str | None,
    json: Path | None,
    html: Path | None,
    out: Path | None,
    workers: int | None,
    scheduler: str | None,
) -> None:
    """Diagnose a fleet under a progress bar, print its summary and write the files that were asked for."""
    with counting_bar(Console(stderr=True)) as bar:
        task = bar.add_task("fleet", total=None, last="")

        def progress(done: int, total: int, last: str) -> None:
            bar.update(task, completed=done, total=total, last=last)

        result = alula.diagnose_fleet(
            folder,
            vehicle,
            out=out,
            effect_files=effects or (),
            mapping=mapping,
            pose=pose,
            workers=workers,
            scheduler=scheduler,
            progress=progress,
        )
    if json is not None:
        result.write_json(json)
    if html is not None:
        result.write_html(html)
    if json != STANDARD_OUTPUT:
        _print(result, Console(file=sys.stdout))
        print_next(*_following(result, folder, vehicle, effects))
    flights = result.report.flights
    if not any(flight.status == "diagnosed" for flight in flights):
        raise DataError(
            f"none of {len(flights)} logs could be diagnosed, the first since: {flights[0].error} "
            f"{result.files[0]} has the reason of every log."
        )


def _following(result: FleetResult, folder: Path, vehicle: str | None, effects: list[Path] | None) -> list[object]:
    """The flight to look at first: the farthest outlier, or else one whose model misses something."""
    flights = {flight.log: flight for flight in result.report.flights}
    open_flights = [flight.log for flight in result.report.flights if flight.verdict not in ("", "explained")]
    names = [*(outlier.log for outlier in result.report.outliers), *open_flights, *flights]
    first = flights[names[0]]
    if not first.vehicle:
        return ["vehicle", "new"]
    own = vehicle if vehicle is not None else str(folder / first.vehicle_file)
    words = ["--vehicle", own, *options([("--effects", effects)])]
    return ["diagnose", folder / first.log, *words, "--html", "report.html"]


def _print(result: FleetResult, console: Console) -> None:
    report = result.report
    for line in result.sentences:
        console.print(line, highlight=False)
    console.print(_vehicles(report))
    drifting = [drift for drift in report.drifts if drift.is_drift]
    for drift in drifting[:SHOWN]:
        slope, low, high = (MONTH * value for value in (drift.slope, drift.low, drift.high))
        unit = "" if drift.unit == "1" else f" {drift.unit}"
        console.print(
            f"drift: {drift.vehicle}, {drift.quantity} {slope:+.3g} ({low:+.3g} to {high:+.3g}){unit} in {MONTH:g} "
            f"days, median {drift.median:.3g} of {drift.flights} flights",
            highlight=False,
            markup=False,
        )
    for outlier in report.outliers[:SHOWN]:
        console.print(
            f"outlier: {outlier.log}: {outlier.quantity} {outlier.value:.3g}, {outlier.median:.3g} in the median of "
            f"{outlier.vehicle} (score {outlier.score:.1f})",
            highlight=False,
            markup=False,
        )
    bad = [flight for flight in report.flights if flight.error]
    for flight in bad[:SHOWN]:
        console.print(f"{flight.status}: {flight.log}: {flight.error}", highlight=False, markup=False)
    left_out = len(bad) - SHOWN
    if left_out > 0:
        console.print(f"and {left_out} more logs without a diagnosis", highlight=False)
    for path in result.files:
        console.print(f"written: {path}", highlight=False, markup=False, soft_wrap=True)


def _vehicles(report: FleetReport) -> Table:
    table = Table("vehicle", title="flights by verdict", title_justify="left")
    verdicts = list(report.verdicts)
    for name in ("flights", *verdicts):
        table.add_column(name, justify="right")
    table.add_column("effects")
    for vehicle in report.vehicles:
        effects = ", ".join(f"{name} {count}" for name, count in list(vehicle.effects.items())[:3])
        counts = [str(vehicle.verdicts.get(name, 0)) for name in verdicts]
        table.add_row(vehicle.label, str(vehicle.flights), *counts, effects)
    return table
