"""`alula sweep`: the paper's studies, grids and searches, many trainings that may be stopped and gone on with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from alula.output import write_json
from alula.workbench import workbench

if TYPE_CHECKING:
    from training.studies.cell import CellResult

STUDIES = "kinds, ablation, history, inertia, rotors, lambda, motors, regimes; grid and search are your own"


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
    seeds: Annotated[int, typer.Option(min=1, help="Trainings of every cell.")] = 2,
    steps: Annotated[int | None, typer.Option(min=1, help="Steps of Adam; 30,000 by default.")] = None,
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
    csv: Annotated[Path | None, typer.Option(help="Folder for the table as CSV.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for pictures, PNG and PDF.")] = None,
) -> None:
    """Train and judge every cell of a study. Killed, the same command goes on and trains nothing twice."""
    with workbench("alula sweep"):
        from alula.sweep_run import Answer, SweepOptions, draw, make_sweep, table_of
        from alula.tables import terminal_table, write_csv
    options = SweepOptions(
        study=study, logs=tuple(logs), tests=tuple(test or ()), vehicle=vehicle, out=out, seeds=seeds, steps=steps,
        batch=batch, recipe=recipe, model=model, grid=tuple(grid or ()), over=tuple(over or ()), trials=trials,
        jobs=jobs, scheduler=scheduler, mapping=mapping,
    )  # fmt: skip
    console = Console(stderr=json_file == Path("-"))
    made = make_sweep(options)
    results: dict[int, CellResult] = {}
    with _bar(console) as bar:
        task = bar.add_task(study, total=made.count, last="")
        for place, result in made.results():
            results[place] = result
            bar.update(task, completed=len(results), last=result.cell.name)
    found = tuple(results[place] for place in sorted(results))
    table = table_of(made, found)
    console.print(terminal_table(table))
    written = [] if csv is None else write_csv([table], csv)
    if json_file is not None:
        write_json(Answer(study, found), json_file)
    if pictures is not None:
        written += draw(made, found, pictures)
    for path in written:
        console.print(f"written: {path}", highlight=False)


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[last]}"),
        TimeElapsedColumn(), TimeRemainingColumn(), console=console,
    )  # fmt: skip
