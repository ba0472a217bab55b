"""`alula doctor`: whether this computer can fly, and how well."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.table import Table
from rich.text import Text

from alula.cli.console import Console
from alula.cli.fly import REALTIME_PRIORITY
from alula.cli.options import LINK, LinkOption
from alula.cli.output import options, print_next
from dynamics.errors import VehicleError
from dynamics.files import STANDARD_OUTPUT, write_answer
from runtime.link.connection import parse_endpoint
from runtime.machine.report import MachineReport, check_machine

COLOURS = {"ok": "green", "warning": "yellow", "problem": "red"}


def doctor(
    link: LinkOption = LINK,
    bundle: Annotated[Path | None, typer.Option(help="Bundle that will fly, instead of a vehicle file.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Check the computer that flies: compiler, scheduling, memory, clock, link's port.

    Each line is ok, a warning (a flight is possible and worse) or a problem (no flight is possible), with what was
    measured and what to do. No vehicle is needed, and nothing is sent.
    """
    report = check_machine(parse_endpoint(link), bundle=bundle, priority=REALTIME_PRIORITY)
    if as_json:
        write_answer({**msgspec.to_builtins(report), "can_fly": report.can_fly}, STANDARD_OUTPUT)
    else:
        _print(report, Console())
        here = options([("--link", link), ("--bundle", bundle)])
        print_next("link" if report.can_fly else "doctor", *here)
    if not report.can_fly:
        names = ", ".join(check.name for check in report.checks if check.state == "problem")
        raise VehicleError(f"This computer cannot fly as it is; the reasons are in the report ({names}).")


def _print(report: MachineReport, console: Console) -> None:
    table = Table(title="this computer", title_justify="left", show_header=False)
    for _ in range(3):
        table.add_column(overflow="fold")
    for check in report.checks:
        text = Text(check.measured)
        if check.advice:
            text.append(f"\ndo: {check.advice}", style="dim" if check.state == "ok" else "")
        table.add_row(Text(check.state, COLOURS[check.state]), check.name, text)
    console.print(table)
    if report.can_fly:
        console.print("[green]can fly[/]: no reason against it in this computer")
