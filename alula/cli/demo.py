"""`alula demo`: flight, diagnosis, addition and flight again, on a simulated vehicle."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from alula.cli.console import Console
from alula.cli.output import print_next
from alula.workbench import require_casadi
from dynamics.command import command_line
from dynamics.errors import RequestError
from dynamics.files import STANDARD_OUTPUT, write_json
from dynamics.workbench_install import workbench_install
from studies.demo import report as demo_report
from studies.demo.flights import DemoOptions
from studies.demo.result import DemoReport
from studies.demo.run import check_options, run_demo
from studies.paper import TRACKING_NOMINAL

DEFAULT = DemoOptions(folder=Path("reports/demo"))
INTERRUPTED = 130  # exit code of a command that Ctrl-C ended


def demo(
    manoeuvre: Annotated[
        list[str] | None, typer.Option(help="What to fly; repeatable. By default three of the paper's eight.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Fly all eight of the paper's manoeuvres.")] = False,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            help="What the vehicle hides: name:key=value,...; repeatable. By default drag of rotors and body."
        ),
    ] = None,
    no_effects: Annotated[bool, typer.Option("--no-effects", help="Hide nothing: no effect is missing.")] = False,
    vehicle: Annotated[str, typer.Option(help="Vehicle file (TOML), or the name of a bundled one.")] = DEFAULT.vehicle,
    duration: Annotated[float, typer.Option(min=5.0, help="Seconds of each manoeuvre.")] = DEFAULT.duration,
    rate: Annotated[float, typer.Option(min=20.0, max=500.0, help="Control rate, Hz.")] = DEFAULT.rate,
    seed: Annotated[int, typer.Option(help="Seed of the simulated vehicle's randomness.")] = DEFAULT.seed,
    out: Annotated[Path, typer.Option(help="Folder for recordings, vehicle file and report.")] = DEFAULT.folder,
    realtime: Annotated[
        bool,
        typer.Option(
            "--realtime/--lockstep",
            help="Fly over a UDP link against the clock, four minutes of a quiet machine, or in simulated time.",
        ),
    ] = False,
    learn: Annotated[bool, typer.Option(help="Diagnose after the first flights, and fly again.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON, progress on stderr.")] = False,
) -> None:
    """Fly the nominal model on a vehicle that hides an effect, diagnose it, add what is missing, fly again."""
    require_casadi("alula demo")
    if no_effects and effect:
        raise RequestError("--no-effects and --effect contradict each other. Give one of them.")
    if every and manoeuvre:
        raise RequestError("--all and --manoeuvre contradict each other. Give one of them.")
    names = tuple(TRACKING_NOMINAL) if every else tuple(manoeuvre or DEFAULT.manoeuvres)
    effects = () if no_effects else DEFAULT.effects if effect is None else tuple(effect)
    options = DemoOptions(out, vehicle, effects, names, duration, rate, seed, realtime, learn)
    console = Console(stderr=as_json)
    how = "over MAVLink, against the clock" if realtime else "in simulated time, by MAVLink's bytes"
    console.print(f"{vehicle} flies with its nominal model {how}; it hides {', '.join(effects) or 'nothing'}")
    check_options(options)
    try:
        with (out / "news.txt").open("w", encoding="utf-8") as log, _progress(console) as started:
            announce = partial(print, file=log, flush=True)
            report, learning = run_demo(options, announce, started, command=command_line())
    except KeyboardInterrupt:
        console.print(f"interrupted; what was flown until then is in {out / 'recordings'}", highlight=False)
        raise typer.Exit(INTERRUPTED) from None
    report = demo_report.write_report(report, out, learning)
    if as_json:
        write_json(report, STANDARD_OUTPUT)
    else:
        _print(report, console)
        print_next("diagnose", out / "recordings", "--vehicle", vehicle)


@contextmanager
def _progress(console: Console) -> Iterator[Callable[[str, float], None]]:
    """A bar of the work that is done, with the time since the start, and the function that moves it."""
    columns = (TextColumn("{task.description:34}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, refresh_per_second=2) as progress:
        task = progress.add_task("starting", total=1.0)

        def show(name: str, share: float) -> None:
            progress.update(task, description=name, completed=share)
            if not console.is_terminal:  # where no bar is drawn
                console.print(f"{share:4.0%}  {name}", highlight=False)

        yield show
        progress.update(task, description="done", completed=1.0)


def _print(report: DemoReport, console: Console) -> None:
    title = "tracking: position RMSE against the reference"
    console.print(_table(title, demo_report.TRACKING_HEADINGS, demo_report.tracking_rows(report)))
    if report.learned is not None:
        title = "prediction: RMSE on a held-out flight"
        console.print(_table(title, demo_report.PREDICTION_HEADINGS, demo_report.prediction_rows(report)))
    for line in demo_report.closing_lines(report):
        console.print(line, highlight=False, markup=False)
    console.print("written: " + ", ".join(report.files), highlight=False)
    if not any(path.endswith(".png") for path in report.files):
        text = f"no picture was drawn: it needs matplotlib: {workbench_install()}."
        console.print(text, highlight=False, markup=False)


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(title=title, title_justify="left")
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="right" if place else "left", no_wrap=not place)
    for row in rows:
        table.add_row(*row)
    return table
