"""`alula demo`: flight, diagnosis, addition and flight again, on a simulated vehicle."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
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
from studies.demo.run import absent_libraries, check_options, run_demo
from studies.paper import TRACKING_NOMINAL

DEFAULT = DemoOptions(folder=Path("reports/demo"))
OVERHEAD = 21.0  # s over the link before and after a manoeuvre
LOCKSTEP_RATIO = 0.15  # s of computing for a second of flight without a link
DIAGNOSIS_TIME = 20.0  # s
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
    duration: Annotated[
        float | None, typer.Option(min=5.0, help="Seconds of each manoeuvre; by default 10, in lockstep 24.")
    ] = None,
    rate: Annotated[float, typer.Option(min=20.0, max=500.0, help="Control rate over the link, Hz.")] = DEFAULT.rate,
    seed: Annotated[int, typer.Option(help="Seed of the simulated vehicle's randomness.")] = DEFAULT.seed,
    out: Annotated[Path, typer.Option(help="Folder for recordings, vehicle file and report.")] = DEFAULT.folder,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Fly in simulated time without a link: a minute instead of four.")
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
    options = DemoOptions(out, vehicle, effects, names, duration, rate, seed, lockstep, learn)
    check_options(options)
    console = Console(stderr=as_json)
    how = "in lockstep" if lockstep else "over MAVLink"
    console.print(f"{vehicle} flies with its nominal model {how}; it hides {', '.join(effects) or 'nothing'}")
    try:
        with (out / "news.txt").open("w", encoding="utf-8") as log, _progress(console, options) as started:
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
def _progress(console: Console, options: DemoOptions) -> Iterator[Callable[[str], None]]:
    """A bar over the expected time of the whole demo, and the function that names the part that starts."""
    columns = (TextColumn("{task.description:28}"), BarColumn(), TimeElapsedColumn())
    expected, start, over = _expected(options), time.monotonic(), threading.Event()
    with Progress(*columns, console=console, refresh_per_second=2) as progress:
        task = progress.add_task("starting", total=expected)

        def follow() -> None:
            while not over.wait(0.5):
                progress.update(task, completed=min(time.monotonic() - start, 0.99 * expected))

        follower = threading.Thread(target=follow, name="progress", daemon=True)
        follower.start()
        try:
            yield lambda name: progress.update(task, description=name)
            progress.update(task, description="done", completed=expected)
        finally:
            over.set()
            follower.join()


def _expected(options: DemoOptions) -> float:
    """Time that the whole demo usually takes, s."""
    flight = LOCKSTEP_RATIO * options.seconds if options.lockstep else options.seconds + OVERHEAD
    half = len(options.manoeuvres) * flight
    return half if absent_libraries() or not options.learn else 2 * half + DIAGNOSIS_TIME


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
