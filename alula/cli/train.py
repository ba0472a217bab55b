"""`alula train`: PI-TCN, its baselines, and grey box + residual, from logs to a checkpoint."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from alula.workbench import workbench
from dynamics.errors import RequestError

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

    from training.checkpoint import TrainedModel
    from training.progress import Report
    from training.run import TrainOptions

Logs = Annotated[
    list[Path], typer.Argument(help="Logs of one vehicle, folders of them, or a campaign's folder.", metavar="LOG...")
]
MODELS = "nominal, pi_tcn, mse_tcn, res_tcn, pi_mlp, window_mlp, grey_box"


def train(
    logs: Logs,
    vehicle: Annotated[str, typer.Option(help="Vehicle file (TOML), or the name of one that is ours.")],
    model: Annotated[str, typer.Option(help=f"What to train: {MODELS}.")],
    out: Annotated[Path, typer.Option(help="Checkpoint to write (.pt); its card goes beside it (.json).")],
    recipe: Annotated[str, typer.Option(help="fast, or paper: PI-TCN to the letter, 10,000 epochs.")] = "fast",
    validation: Annotated[
        str | None, typer.Option(help="File names to choose the best step by, as a pattern; by default every tenth.")
    ] = None,
    hold_out: Annotated[str | None, typer.Option(help="File names not to look at at all, as a pattern.")] = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(help="Effect to add to the vehicle file's, name or name:key=value,...; repeatable."),
    ] = None,
    keep_effects: Annotated[
        bool, typer.Option("--keep-effects", help="Do not fit the vehicle file's effects to these flights.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first member; the others count on from it.")] = 0,
    ensemble: Annotated[int, typer.Option(min=1, help="Members; their disagreement flags what is uncertain.")] = 4,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; one for every core by default.")] = None,
    device: Annotated[str, typer.Option(help="cpu, cuda, cuda:1; for several GPUs start with torchrun -m alula.")] = (
        "cpu"
    ),
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a training that was interrupted.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing checkpoint.")] = False,
    tensorboard: Annotated[Path | None, typer.Option(help="Folder for TensorBoard's curves.")] = None,
    mapping: Annotated[Path | None, typer.Option(help="Column mapping (TOML) for CSV files of other tools.")] = None,
    inputs: Annotated[str | None, typer.Option(help="body or world frame; of the model by default.")] = None,
    motors: Annotated[str | None, typer.Option(help="command or measured rotor speeds.")] = None,
    label: Annotated[str | None, typer.Option(help="mean_increment over 10 ms, or instantaneous.")] = None,
    filtered_inputs: Annotated[
        bool | None,
        typer.Option(
            "--filtered-inputs/--causal-inputs",
            help="The paper's filter on the inputs, which sees the future; causal ones can fly.",
        ),
    ] = None,
    history: Annotated[int | None, typer.Option(min=1, help="Columns that the network sees.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Steps of the optimiser; 10,000 by default.")] = None,
    batch: Annotated[int | None, typer.Option(min=1, help="Windows a step; 256 by default.")] = None,
    optimiser: Annotated[str | None, typer.Option(help="muon or adam; muon by default.")] = None,
    learning_rate: Annotated[float | None, typer.Option(help="The highest one; 3e-3 by default.")] = None,
    patience: Annotated[
        int | None, typer.Option(min=0, help="Evaluations without a better one that end a member; 0 for never.")
    ] = None,
    physics_weight: Annotated[
        float | None, typer.Option(min=0, help="lambda of the physics-inspired loss; 1 for pi_tcn and pi_mlp.")
    ] = None,
    physics_points: Annotated[str | None, typer.Option(help="plausible histories, the whole space, or pulses.")] = None,
    annealed: Annotated[bool | None, typer.Option("--annealed", help="Let lambda fall to 0 towards the end.")] = None,
    rollout: Annotated[int | None, typer.Option(min=1, help="Steps that are predicted from predictions.")] = None,
    input_noise: Annotated[
        float | None, typer.Option(min=0, help="Noise on the measured state, in its standard deviations.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the card as JSON, progress on stderr.")] = False,
) -> None:
    """Train a model of a vehicle's accelerations from its flights; say how it errs on flights it was not trained on."""
    with workbench("alula train"):
        from training.run import TrainOptions, run
    options = TrainOptions(
        logs=tuple(logs), vehicle=vehicle, model=model, out=out, recipe=recipe, validation=validation,
        hold_out=hold_out, effects=tuple(effect or ()), keep_effects=keep_effects, seed=seed, ensemble=ensemble,
        jobs=jobs, device=device, resume=resume, overwrite=overwrite, mapping=mapping,
        config=_given(inputs=inputs, motors=motors, label=label, filtered_inputs=filtered_inputs, history=history),
        recipe_changes=_given(
            steps=steps, batch=batch, optimiser=optimiser, learning_rate=learning_rate, patience=patience,
            physics_weight=physics_weight, physics_points=physics_points, annealed=annealed, rollout=rollout,
            input_noise=input_noise,
        ),
    )  # fmt: skip
    console = Console(stderr=as_json, quiet=os.environ.get("RANK", "0") != "0")
    trained = _with_bars(run, options, console, tensorboard)
    if as_json:
        sys.stdout.buffer.write(msgspec.json.format(msgspec.json.encode(trained.card)) + b"\n")
    else:
        _print(trained, out, console)


def _with_bars(
    run: Callable[[TrainOptions, Callable[[Report], None]], TrainedModel], options: TrainOptions, console: Console,
    tensorboard: Path | None,
) -> TrainedModel:  # fmt: skip
    """The trained model, with a bar for every member meanwhile; interrupted it says how to go on."""
    bars = _Bars(console, tensorboard)
    try:
        with bars.progress:
            return run(options, bars.show)
    except KeyboardInterrupt:
        if options.folder.exists():
            console.print(f"stopped; {options.folder} holds what is done: the same command with --resume goes on.")
        raise
    finally:
        bars.close()


def _given(**values: Any) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


class _Bars:
    """A bar for each member with its losses and the time left, and the same as curves for TensorBoard."""

    def __init__(self, console: Console, tensorboard: Path | None) -> None:
        self.progress = Progress(  # 80 columns wide in all
            TextColumn("{task.description}"), BarColumn(bar_width=10), TaskProgressColumn(),
            TextColumn("{task.fields[losses]}"), TimeElapsedColumn(), TimeRemainingColumn(), console=console,
        )  # fmt: skip
        self._tasks: dict[int, Any] = {}
        self._writer: SummaryWriter | None = None
        if tensorboard is not None:
            from torch.utils.tensorboard import SummaryWriter  # a second to import, for those who want it

            try:
                self._writer = SummaryWriter(str(tensorboard))
            except OSError as error:
                raise RequestError(
                    f"cannot write to {tensorboard}: {error.strerror or error}. Give another --tensorboard."
                ) from error

    def show(self, report: Report) -> None:
        """Where a member stands."""
        if report.member not in self._tasks:
            self._tasks[report.member] = self.progress.add_task(
                f"member {report.member}", total=report.steps, losses=""
            )  # fmt: skip
        physics = "" if report.physics_loss is None else f" PI {report.physics_loss:.3g}"
        losses = f"loss {report.loss:.3g}{physics} val {report.validation:.3g}"
        self.progress.update(self._tasks[report.member], completed=report.step, losses=losses)
        if self._writer is not None:
            told = {"loss": report.loss, "validation": report.validation, "learning rate": report.learning_rate}
            for name, value in (told | _given(physics=report.physics_loss)).items():
                self._writer.add_scalar(f"member {report.member}/{name}", value, report.step)

    def close(self) -> None:
        """Write what TensorBoard has not got yet."""
        if self._writer is not None:
            self._writer.close()


def _print(trained: TrainedModel, out: Path, console: Console) -> None:
    table = Table("validation flight", title="RMSE against the labels", title_justify="left")
    for heading in ("m/s²", "rad/s²", "both", "of nominal", "of base"):
        table.add_column(heading, justify="right")
    for error in trained.card.errors:
        base = "" if error.base is None else f"{error.combined / error.base:.2f}"
        table.add_row(
            error.flight, f"{error.linear:.3f}", f"{error.angular:.3f}", f"{error.combined:.3f}",
            f"{error.combined / error.nominal:.3f}", base,
        )  # fmt: skip
    console.print(table)
    for use in trained.vehicle.effects if trained.config.base == "grey_box" else ():
        values = ", ".join(f"{name} {value:.5g}" for name, value in use.parameters.items())
        console.print(f"{use.name}: {values}", highlight=False)
    for note in trained.card.notes:
        console.print(f"note: {note}", highlight=False)
    console.print(f"written: {out}, {out.with_suffix('.json')}", highlight=False)
