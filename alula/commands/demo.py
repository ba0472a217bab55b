"""`alula demo`: the main job end to end on the embedded mock."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from alula.demo import DemoOptions, DemoReport, check_options, run_demo
from alula.demo_report import write_report
from alula.paper import TRACKING_NOMINAL

USUAL = DemoOptions(folder=Path("reports/demo"))
AROUND = 16.0  # s that take-off, approach, return and landing usually add to a manoeuvre


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
    vehicle: Annotated[str, typer.Option(help="Vehicle file (TOML), or the name of one that comes along.")] = (
        USUAL.vehicle
    ),
    duration: Annotated[float, typer.Option(min=5.0, help="Seconds of each manoeuvre.")] = USUAL.duration,
    rate: Annotated[float, typer.Option(min=20.0, max=500.0, help="Control rate, Hz.")] = USUAL.rate,
    seed: Annotated[int, typer.Option(help="Seed of the mock's randomness.")] = USUAL.seed,
    out: Annotated[Path, typer.Option(help="Folder for recordings and report.")] = USUAL.folder,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON, progress on stderr.")] = False,
) -> None:
    """Fly the textbook model over MAVLink on a mock vehicle that hides an effect; table, picture, recordings."""
    names = tuple(TRACKING_NOMINAL) if every else tuple(manoeuvre or USUAL.manoeuvres)
    effects = USUAL.effects if effect is None else tuple(effect)
    options = DemoOptions(out, vehicle, effects, names, duration, rate, seed)
    check_options(options)
    console = Console(stderr=as_json)
    console.print(f"{vehicle} flies its textbook model over MAVLink; it hides {', '.join(effects) or 'nothing'}")
    out.mkdir(parents=True, exist_ok=True)
    with (out / "news.txt").open("w", encoding="utf-8") as news, _progress(console, options) as started:
        report = run_demo(options, lambda line: print(line, file=news, flush=True), started)
    report = write_report(report, out)
    if as_json:
        sys.stdout.buffer.write(msgspec.json.format(msgspec.json.encode(report)) + b"\n")
    else:
        _print(report, console)


@contextmanager
def _progress(console: Console, options: DemoOptions) -> Iterator[Callable[[str], None]]:
    """A bar over the expected time of all flights, and the function that tells it which one begins."""
    columns = (TextColumn("{task.description:24}"), BarColumn(), TimeElapsedColumn())
    expected = len(options.manoeuvres) * (options.duration + AROUND)
    began, over = time.monotonic(), threading.Event()
    with Progress(*columns, console=console, refresh_per_second=2) as progress:
        task = progress.add_task("starting", total=expected)

        def follow() -> None:
            while not over.wait(0.5):
                progress.update(task, completed=min(time.monotonic() - began, 0.99 * expected))

        follower = threading.Thread(target=follow, name="progress", daemon=True)
        follower.start()
        try:
            yield lambda name: progress.update(task, description=f"flying {name}")
            progress.update(task, description="flown", completed=expected)
        finally:
            over.set()
            follower.join()


def _print(report: DemoReport, console: Console) -> None:
    table = Table("manoeuvre", title="tracking, textbook model", title_justify="left")
    for heading in ("top speed m/s", "position RMSE m", "greatest m", "paper's nominal m"):
        table.add_column(heading, justify="right")
    for flown in report.nominal:
        paper = "" if flown.paper_rmse is None else f"{flown.paper_rmse:.3f}"
        figures = [f"{flown.speed_max:.2f}", f"{flown.position_rmse:.3f}", f"{flown.position_max:.3f}", paper]
        table.add_row(flown.name, *figures)
    console.print(table)
    console.print("written: " + ", ".join(report.files), highlight=False)
    if not any(path.endswith(".png") for path in report.files):
        console.print("no picture was drawn: it needs matplotlib, which comes with alula\\[workbench]")
