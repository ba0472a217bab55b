"""`alula sweep`: the paper's studies, grids and searches, many trainings that may be stopped and gone on with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from alula.workbench import workbench

if TYPE_CHECKING:
    from studies.sweep.cell import Outcome
    from studies.sweep.run import Sweep

STUDIES = "kinds, ablation, history, inertia, rotors, lambda, motors, regimes, starred; grid and search are your own"


def sweep(
    study: Annotated[str, typer.Argument(help=f"What to vary: {STUDIES}.")],
    logs: Annotated[
        list[Path], typer.Argument(help="Training logs, folders of them, or a campaign's folder.", metavar="LOG...")
    ],
    vehicle: Annotated[str, typer.Option(help="Vehicle file (TOML), or the name of one that is ours.")],
    out: Annotated[Path, typer.Option(help="Folder for a file each cell; a sweep that was stopped goes on from it.")],
    test: Annotated[
        list[Path] | None, typer.Option(help="Logs or folders to judge on; a campaign's test flights by default.")
    ] = None,
    simulated: Annotated[
        list[Path] | None,
        typer.Option(help="For starred: logs of a simulation without effects (alula campaign --no-effects)."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Trainings of every cell.")] = 2,
    steps: Annotated[int | None, typer.Option(min=1, help="Steps of the optimiser; 10,000 by default.")] = None,
    batch: Annotated[int | None, typer.Option(min=1, help="Windows a step; 256 by default.")] = None,
    recipe: Annotated[str, typer.Option(help="fast, or paper.")] = "fast",
    model: Annotated[str, typer.Option(help="For grid and search: what to train.")] = "pi_tcn",
    grid: Annotated[
        list[str] | None, typer.Option(help="For grid: NAME=VALUE,VALUE,... of the recipe or the model; repeatable.")
    ] = None,
    over: Annotated[
        list[str] | None,
        typer.Option(help="For search: NAME=LOW:HIGH of the recipe; physics_weight=1e-4:1 by default."),
    ] = None,
    trials: Annotated[int, typer.Option(min=1, help="For search: trainings in all.")] = 20,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; one for every core by default.")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Address of a Dask scheduler (tcp://host:port); its workers see the same folders."),
    ] = None,
    mapping: Annotated[Path | None, typer.Option(help="Column mapping (TOML) for CSV files of other tools.")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write every cell as JSON; - for stdout.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Folder for one CSV file a table.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for pictures, PNG and PDF.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write tables and pictures as one page to this file.")] = None,
) -> None:
    """Train and judge every cell of a study. Killed, the same command goes on and trains nothing twice."""
    with workbench("alula sweep"):
        from studies.sweep.report import require_all_trained, show
        from studies.sweep.run import SweepOptions, make_sweep
    options = SweepOptions(
        study=study, logs=tuple(logs), tests=tuple(test or ()), vehicle=vehicle, out=out,
        simulated=tuple(simulated or ()), seeds=seeds, steps=steps, batch=batch, recipe=recipe, model=model,
        grid=tuple(grid or ()), over=tuple(over or ()), trials=trials, jobs=jobs, scheduler=scheduler, mapping=mapping,
    )  # fmt: skip
    console = Console(stderr=json_file == Path("-"))
    made = make_sweep(options)
    outcomes = _outcomes(made, console)
    show(made, outcomes, console, json_file=json_file, csv=csv, pictures=pictures, html=html)
    require_all_trained(outcomes)


def _outcomes(made: Sweep, console: Console) -> tuple[Outcome, ...]:
    """Every cell's outcome in the cells' order, under a progress bar."""
    found: dict[int, Outcome] = {}
    with _bar(console) as bar:
        task = bar.add_task(made.study, total=made.count, last="")
        for place, outcome in made.outcomes():
            found[place] = outcome
            bar.update(task, completed=len(found), last=outcome.cell.name)
    return tuple(found[place] for place in sorted(found))


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[last]}"),
        TimeElapsedColumn(), TimeRemainingColumn(), console=console,
    )  # fmt: skip
