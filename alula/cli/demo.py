"""`alula demo`: the main job end to end on a simulated vehicle."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from dynamics.command import command_line
from studies.demo import report as told
from studies.demo.flights import DemoOptions
from studies.demo.result import DemoReport
from studies.demo.run import absent_libraries, check_options, run_demo
from studies.paper import TRACKING_NOMINAL

USUAL = DemoOptions(folder=Path("reports/demo"))
AROUND, COMPUTING = 21.0, 0.15  # s around a manoeuvre over the link; s of computing a second of flight without it
DIAGNOSING = 20.0  # s
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
    no_effects: Annotated[bool, typer.Option("--no-effects", help="Hide nothing: there is nothing to find.")] = False,
    vehicle: Annotated[str, typer.Option(help="Vehicle file (TOML), or the name of one that comes along.")] = (
        USUAL.vehicle
    ),
    duration: Annotated[
        float | None, typer.Option(min=5.0, help="Seconds of each manoeuvre; by default 10, in lockstep 24.")
    ] = None,
    rate: Annotated[float, typer.Option(min=20.0, max=500.0, help="Control rate over the link, Hz.")] = USUAL.rate,
    seed: Annotated[int, typer.Option(help="Seed of the simulated vehicle's randomness.")] = USUAL.seed,
    out: Annotated[Path, typer.Option(help="Folder for recordings, vehicle file and report.")] = USUAL.folder,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Fly in simulated time without a link: a minute instead of four.")
    ] = False,
    learn: Annotated[bool, typer.Option(help="Go on after the flights with the textbook model.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON, progress on stderr.")] = False,
) -> None:
    """Fly the textbook model on a vehicle that hides an effect, diagnose that, add what is missing, fly again."""
    names = tuple(TRACKING_NOMINAL) if every else tuple(manoeuvre or USUAL.manoeuvres)
    effects = () if no_effects else USUAL.effects if effect is None else tuple(effect)
    options = DemoOptions(out, vehicle, effects, names, duration, rate, seed, lockstep, learn)
    check_options(options)
    console = Console(stderr=as_json)
    how = "in lockstep" if lockstep else "over MAVLink"
    console.print(f"{vehicle} flies its textbook model {how}; it hides {', '.join(effects) or 'nothing'}")
    command = command_line()
    try:
        with (out / "news.txt").open("w", encoding="utf-8") as news, _progress(console, options) as started:
            announce = partial(print, file=news, flush=True)
            report, learning = run_demo(options, announce, started, command=command)
    except KeyboardInterrupt:
        console.print(f"interrupted; what was flown until then is in {out / 'recordings'}", highlight=False)
        raise typer.Exit(INTERRUPTED) from None
    report = told.write_report(report, out, learning)
    if as_json:
        sys.stdout.buffer.write(msgspec.json.format(msgspec.json.encode(report)) + b"\n")
    else:
        _print(report, console)


@contextmanager
def _progress(console: Console, options: DemoOptions) -> Iterator[Callable[[str], None]]:
    """A bar over the expected time of everything, and the function that tells it which part begins."""
    columns = (TextColumn("{task.description:28}"), BarColumn(), TimeElapsedColumn())
    expected, began, over = _expected(options), time.monotonic(), threading.Event()
    with Progress(*columns, console=console, refresh_per_second=2) as progress:
        task = progress.add_task("starting", total=expected)

        def follow() -> None:
            while not over.wait(0.5):
                progress.update(task, completed=min(time.monotonic() - began, 0.99 * expected))

        follower = threading.Thread(target=follow, name="progress", daemon=True)
        follower.start()
        try:
            yield lambda name: progress.update(task, description=name)
            progress.update(task, description="done", completed=expected)
        finally:
            over.set()
            follower.join()


def _expected(options: DemoOptions) -> float:
    """Seconds that the whole demo usually takes."""
    flight = COMPUTING * options.seconds if options.lockstep else options.seconds + AROUND
    half = len(options.manoeuvres) * flight
    return half if absent_libraries() or not options.learn else 2 * half + DIAGNOSING


def _print(report: DemoReport, console: Console) -> None:
    console.print(
        _table("tracking: position RMSE against the reference", told.TRACKING_HEADINGS, told.tracking_rows(report))
    )
    if report.learned is not None:
        title = "prediction: RMSE on a flight that nothing was fitted on"
        console.print(_table(title, told.PREDICTION_HEADINGS, told.prediction_rows(report)))
    for line in told.closing_lines(report):
        console.print(line, highlight=False, markup=False)
    console.print("written: " + ", ".join(report.files), highlight=False)
    if not any(path.endswith(".png") for path in report.files):
        console.print("no picture was drawn: it needs matplotlib, which comes with alula\\[workbench]")


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(title=title, title_justify="left")
    for place, heading in enumerate(headings):
        table.add_column(heading, justify="right" if place else "left", no_wrap=not place)
    for row in rows:
        table.add_row(*row)
    return table
