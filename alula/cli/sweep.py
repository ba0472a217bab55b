"""`alula sweep`: the paper's studies, grids and searches, many trainings that may be stopped and continued."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from alula.cli.console import Console
from alula.cli.intake import vehicle_of_logs
from alula.cli.options import Effects, Mapping, RecordedSystem, VehicleOption
from alula.cli.output import print_next
from alula.cli.progress import counting_bar
from alula.workbench import workbench
from dynamics.files import STANDARD_OUTPUT
from studies.sweep.catalogue import DEFAULT_RANGE, GRID, SEARCH, STARRED, STUDIES
from training.models import KINDS
from training.recipe import FAST, RECIPES

if TYPE_CHECKING:
    from studies.sweep.cell import Outcome
    from studies.sweep.run import Sweep

TRAINING, OWN, RUN, REPORT = "Training of a cell", f"{GRID} and {SEARCH}", "Run", "Report"


def sweep(
    study: Annotated[
        str,
        typer.Argument(help=f"What to vary: {', '.join(STUDIES)}; {GRID} and {SEARCH} are your own."),
    ],
    logs: Annotated[
        list[Path], typer.Argument(help="Training logs, folders of them, or a campaign's folder.", metavar="LOG...")
    ],
    out: Annotated[Path, typer.Option(help="Folder with a file each cell; a sweep that was stopped continues there.")],
    vehicle: VehicleOption = None,
    test: Annotated[
        list[Path] | None, typer.Option(help="Held-out logs or folders; a campaign's test flights by default.")
    ] = None,
    simulated: Annotated[
        list[Path] | None,
        typer.Option(help=f"For {STARRED}: logs of a simulation without effects (alula campaign --no-effects)."),
    ] = None,
    mapping: Mapping = None,
    system: RecordedSystem = None,
    effects: Effects = None,
    seeds: Annotated[int, typer.Option(min=1, help="Trainings of every cell.", rich_help_panel=TRAINING)] = 2,
    steps: Annotated[
        int | None,
        typer.Option(min=1, help=f"Steps of the optimiser; {FAST.steps:,} by default.", rich_help_panel=TRAINING),
    ] = None,
    batch: Annotated[
        int | None, typer.Option(min=1, help=f"Windows a step; {FAST.batch} by default.", rich_help_panel=TRAINING)
    ] = None,
    recipe: Annotated[str, typer.Option(help=f"{' or '.join(RECIPES)}.", rich_help_panel=TRAINING)] = "fast",
    model: Annotated[str, typer.Option(help=f"What to train: {', '.join(KINDS)}.", rich_help_panel=OWN)] = "pi_tcn",
    grid: Annotated[
        list[str] | None,
        typer.Option(
            help=f"For {GRID}: NAME=VALUE,VALUE,... of the recipe or the model; repeatable.", rich_help_panel=OWN
        ),
    ] = None,
    over: Annotated[
        list[str] | None,
        typer.Option(
            help=f"For {SEARCH}: NAME=LOW:HIGH of the recipe; {DEFAULT_RANGE} by default.", rich_help_panel=OWN
        ),
    ] = None,
    trials: Annotated[int, typer.Option(min=1, help=f"For {SEARCH}: trainings in all.", rich_help_panel=OWN)] = 20,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes; one for every core by default.", rich_help_panel=RUN)
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Address of a Dask scheduler (tcp://host:port); its workers need the same folders.",
            rich_help_panel=RUN,
        ),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write every cell as JSON; - for stdout.", rich_help_panel=REPORT)
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="Folder for one CSV file a table.", rich_help_panel=REPORT)] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for pictures, PNG and PDF.", rich_help_panel=REPORT)
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(help="Write tables and pictures as one page to this file.", rich_help_panel=REPORT),
    ] = None,
) -> None:
    """Train and evaluate every cell of a study. The same command continues a stopped one and trains nothing twice."""
    with workbench("alula sweep"):
        from studies.sweep.report import require_all_trained, show
        from studies.sweep.run import SweepOptions, make_sweep
    vehicle = vehicle_of_logs(logs, vehicle, mapping)
    options = SweepOptions(
        study=study,
        logs=tuple(logs),
        tests=tuple(test or ()),
        vehicle=vehicle,
        out=out,
        simulated=tuple(simulated or ()),
        seeds=seeds,
        steps=steps,
        batch=batch,
        recipe=recipe,
        model=model,
        grid=tuple(grid or ()),
        over=tuple(over or ()),
        trials=trials,
        jobs=jobs,
        scheduler=scheduler,
        mapping=mapping,
        effect_files=tuple(path.resolve() for path in effects or ()),
    )
    console = Console(stderr=json_file == STANDARD_OUTPUT)
    made = make_sweep(options)
    outcomes = _outcomes(made, console)
    show(made, outcomes, console, json_file=json_file, csv=csv, pictures=pictures, html=html)
    require_all_trained(outcomes)
    if json_file != STANDARD_OUTPUT:
        print_next("train", *logs, "--vehicle", vehicle, "--model", model, "--out", f"{model}.pt")


def _outcomes(made: Sweep, console: Console) -> tuple[Outcome, ...]:
    """Every cell's outcome in the cells' order, under a progress bar."""
    finished: dict[int, Outcome] = {}
    with counting_bar(console) as bar:
        task = bar.add_task(made.study, total=made.count, last="")
        for place, outcome in made.outcomes():
            finished[place] = outcome
            bar.update(task, completed=len(finished), last=outcome.cell.name)
    return tuple(finished[place] for place in sorted(finished))
