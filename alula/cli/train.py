"""`alula train`: PI-TCN, its baselines, and grey box + residual, from logs to a checkpoint."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

import alula
from alula.cli.console import Console
from alula.cli.intake import vehicle_of_logs
from alula.cli.options import Effects, Mapping, RecordedSystem, VehicleOption
from alula.cli.output import print_next
from dynamics.errors import RequestError
from dynamics.files import STANDARD_OUTPUT, write_answer
from training.config import ModelConfig
from training.folder import run_folder
from training.models import KINDS
from training.overrides import choices_of
from training.recipe import FAST, RECIPES, Recipe

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

    from training.checkpoint import TrainedModel
    from training.reports import Report

Logs = Annotated[
    list[Path], typer.Argument(help="Logs of one vehicle, folders of them, or a campaign's folder.", metavar="LOG...")
]
FLIGHTS, MODEL, RECIPE, RUN = "Flights", "Model, instead of its own definition", "Recipe, instead of its own", "Run"


def train(
    logs: Logs,
    model: Annotated[str, typer.Option(help=f"What to train: {', '.join(KINDS)}.")],
    out: Annotated[Path, typer.Option(help="Checkpoint to write (.pt); its card lies beside it (.json).")],
    vehicle: VehicleOption = None,
    recipe: Annotated[
        str, typer.Option(help=f"How to train: {' or '.join(RECIPES)}; paper is PI-TCN to the letter, 10,000 epochs.")
    ] = "fast",
    validation: Annotated[
        str | None,
        typer.Option(
            help="File names to choose the best step by, as a pattern; by default every tenth.",
            rich_help_panel=FLIGHTS,
        ),
    ] = None,
    hold_out: Annotated[
        str | None, typer.Option(help="File names not to read at all, as a pattern.", rich_help_panel=FLIGHTS)
    ] = None,
    mapping: Mapping = None,
    system: RecordedSystem = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            help="Effect to add to the vehicle file's, name or name:key=value,...; repeatable. diagnosed: all that a "
            "diagnosis of the training flights names.",
            rich_help_panel=MODEL,
        ),
    ] = None,
    effects: Effects = None,
    keep_effects: Annotated[
        bool,
        typer.Option(
            "--keep-effects", help="Do not fit the vehicle file's effects to these flights.", rich_help_panel=MODEL
        ),
    ] = False,
    inputs: Annotated[
        str | None,
        typer.Option(help=f"Frame of the inputs: {choices_of(ModelConfig, 'inputs')}.", rich_help_panel=MODEL),
    ] = None,
    motors: Annotated[
        str | None,
        typer.Option(help=f"Rotor speeds: {choices_of(ModelConfig, 'motors')}.", rich_help_panel=MODEL),
    ] = None,
    label: Annotated[
        str | None,
        typer.Option(
            help=f"Accelerations to predict: {choices_of(ModelConfig, 'label')} over 10 ms.", rich_help_panel=MODEL
        ),
    ] = None,
    filtered_inputs: Annotated[
        bool | None,
        typer.Option(
            "--filtered-inputs/--causal-inputs",
            help="The paper's filter on the inputs, which needs the future; causal ones can fly.",
            rich_help_panel=MODEL,
        ),
    ] = None,
    history: Annotated[
        int | None, typer.Option(min=1, help="Columns of the network's window.", rich_help_panel=MODEL)
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(min=1, help=f"Steps of the optimiser; {FAST.steps:,} by default.", rich_help_panel=RECIPE),
    ] = None,
    batch: Annotated[
        int | None, typer.Option(min=1, help=f"Windows a step; {FAST.batch} by default.", rich_help_panel=RECIPE)
    ] = None,
    optimiser: Annotated[
        str | None,
        typer.Option(
            help=f"One of {choices_of(Recipe, 'optimiser')}; {FAST.optimiser} by default.", rich_help_panel=RECIPE
        ),
    ] = None,
    learning_rate: Annotated[
        float | None,
        typer.Option(help=f"The maximum; {FAST.learning_rate:g} by default.", rich_help_panel=RECIPE),
    ] = None,
    patience: Annotated[
        int | None,
        typer.Option(
            min=0, help="Evaluations without a better one that end a member; 0 for never.", rich_help_panel=RECIPE
        ),
    ] = None,
    physics_weight: Annotated[
        float | None,
        typer.Option(
            min=0, help="lambda of the physics-inspired loss; 1 for pi_tcn and pi_mlp.", rich_help_panel=RECIPE
        ),
    ] = None,
    physics_points: Annotated[
        str | None,
        typer.Option(help=f"Where that loss compares: {choices_of(Recipe, 'physics_points')}.", rich_help_panel=RECIPE),
    ] = None,
    annealed: Annotated[
        bool | None, typer.Option("--annealed", help="Let lambda fall to 0 towards the end.", rich_help_panel=RECIPE)
    ] = None,
    rollout: Annotated[
        int | None, typer.Option(min=1, help="Steps that are predicted from predictions.", rich_help_panel=RECIPE)
    ] = None,
    input_noise: Annotated[
        float | None,
        typer.Option(min=0, help="Noise on the measured state, in its standard deviations.", rich_help_panel=RECIPE),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the first member; the others count on from it.", rich_help_panel=RUN)
    ] = 0,
    ensemble: Annotated[
        int, typer.Option(min=1, help="Members; their disagreement flags what is uncertain.", rich_help_panel=RUN)
    ] = 4,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes; one for every core by default.", rich_help_panel=RUN)
    ] = None,
    device: Annotated[
        str,
        typer.Option(help="cpu, cuda, cuda:1; for several GPUs start with torchrun -m alula.", rich_help_panel=RUN),
    ] = "cpu",
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue an interrupted training.", rich_help_panel=RUN)
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing checkpoint.", rich_help_panel=RUN)
    ] = False,
    tensorboard: Annotated[
        Path | None, typer.Option(help="Folder for TensorBoard's curves.", rich_help_panel=RUN)
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the card as JSON, progress on stderr.", rich_help_panel=RUN)
    ] = False,
) -> None:
    """Train a model of a vehicle's accelerations from its flights, and report its errors on validation flights."""
    vehicle = vehicle_of_logs(logs, vehicle, mapping)
    console = Console(stderr=as_json, quiet=os.environ.get("RANK", "0") != "0")
    with _bars(out, console, tensorboard) as bars:
        result = alula.train(
            logs,
            vehicle,
            model=model,
            out=out,
            recipe=recipe,
            validation=validation,
            hold_out=hold_out,
            added_effects=effect or (),
            effect_files=effects or (),
            keep_effects=keep_effects,
            seed=seed,
            ensemble=ensemble,
            jobs=jobs,
            device=device,
            resume=resume,
            overwrite=overwrite,
            mapping=mapping,
            progress=bars.show,
            config=_without_none(
                inputs=inputs, motors=motors, label=label, filtered_inputs=filtered_inputs, history=history
            ),
            overrides=_without_none(
                steps=steps,
                batch=batch,
                optimiser=optimiser,
                learning_rate=learning_rate,
                patience=patience,
                physics_weight=physics_weight,
                physics_points=physics_points,
                annealed=annealed,
                rollout=rollout,
                input_noise=input_noise,
            ),
        )
    if as_json:
        write_answer(result.report, STANDARD_OUTPUT)
    else:
        _print(result.model, out, console)
        _print_advice(result.report.of_nominal, logs, vehicle, out, console)


def _print_advice(of_nominal: float, logs: Sequence[Path], vehicle: str, out: Path, console: Console) -> None:
    """The next command: a bundle of a model that is better than the nominal one, else what is missing from that."""
    if not of_nominal >= 1:
        print_next("export", out, "--out", out.with_suffix(""))
        return
    console.print(
        f"not to be flown: on the validation flights it errs {of_nominal:.3g} times as much as the nominal model. More "
        "steps (--steps), more and faster flights, or physics first (--model grey_box --effect diagnosed); the effects "
        "that a diagnosis names fly without a network",
        highlight=False,
    )
    print_next("diagnose", *logs, "--vehicle", vehicle)


@contextmanager
def _bars(out: Path, console: Console, tensorboard: Path | None) -> Iterator[_Bars]:
    """A bar for every member inside; an interrupt prints how to continue."""
    bars = _Bars(console, tensorboard)
    try:
        with bars.progress:
            yield bars
    except KeyboardInterrupt:
        if (folder := run_folder(out)).exists():
            console.print(f"stopped; {folder} holds what is done: the same command with --resume continues.")
        raise
    finally:
        bars.close()


def _without_none(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


class _Bars:
    """A bar for each member with its losses and the time that remains, and the same as curves for TensorBoard."""

    def __init__(self, console: Console, tensorboard: Path | None) -> None:
        self.progress = Progress(  # 80 columns wide in all
            TextColumn("{task.description}"),
            BarColumn(bar_width=10),
            TaskProgressColumn(),
            TextColumn("{task.fields[losses]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
        )
        self._tasks: dict[int, Any] = {}
        self._writer: SummaryWriter | None = None
        if tensorboard is not None:
            from torch.utils.tensorboard import SummaryWriter  # a second to import, and only for curves

            try:
                self._writer = SummaryWriter(str(tensorboard))
            except OSError as error:
                raise RequestError(
                    f"cannot write to {tensorboard}: {error.strerror or error}. Give another --tensorboard."
                ) from error

    def show(self, report: Report) -> None:
        """Update the bar and the curves of a member."""
        if report.member not in self._tasks:
            self._tasks[report.member] = self.progress.add_task(
                f"member {report.member}", total=report.steps, losses=""
            )
        physics = "" if report.physics_loss is None else f" PI {report.physics_loss:.3g}"
        losses = f"loss {report.loss:.3g}{physics} val {report.validation:.3g}"
        self.progress.update(self._tasks[report.member], completed=report.step, losses=losses)
        if self._writer is not None:
            curves = {"loss": report.loss, "validation": report.validation, "learning rate": report.learning_rate}
            for name, value in (curves | _without_none(physics=report.physics_loss)).items():
                self._writer.add_scalar(f"member {report.member}/{name}", value, report.step)

    def close(self) -> None:
        """Write the curves to their end."""
        if self._writer is not None:
            self._writer.close()


def _print(trained: TrainedModel, out: Path, console: Console) -> None:
    table = Table("validation flight", title="RMSE against the labels", title_justify="left")
    for heading in ("m/s²", "rad/s²", "both", "of nominal", "of base"):
        table.add_column(heading, justify="right")
    for error in trained.card.errors:
        base = "" if error.base is None else f"{error.combined / error.base:.2f}"
        table.add_row(
            error.flight,
            f"{error.linear:.3f}",
            f"{error.angular:.3f}",
            f"{error.combined:.3f}",
            f"{error.combined / error.nominal:.3f}",
            base,
        )
    console.print(table)
    for use in trained.vehicle.effects if trained.config.base == "grey_box" else ():
        values = ", ".join(f"{name} {value:.5g}" for name, value in use.parameters.items())
        console.print(f"{use.name}: {values}", highlight=False)
    for note in trained.card.notes:
        console.print(f"note: {note}", highlight=False)
    console.print(f"written: {out}, {out.with_suffix('.json')}", highlight=False)
