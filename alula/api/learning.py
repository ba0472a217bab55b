"""Learned models: trained on flights, evaluated on others, exported as bundles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from alula.api.inputs import log_paths
from alula.api.results import EvaluationResult, ExportResult, TrainingResult
from alula.workbench import workbench
from dynamics.command import command_line
from dynamics.recorded_vehicle import system_chosen
from dynamics.trust import approve_given

if TYPE_CHECKING:
    from runtime.control.bundle import Integrator
    from training.reports import Report


def train(
    logs: str | Path | Sequence[str | Path],
    vehicle: str | Path,
    *,
    model: str,
    out: str | Path,
    recipe: str = "fast",
    config: Mapping[str, Any] | None = None,
    overrides: Mapping[str, Any] | None = None,
    added_effects: Sequence[str] = (),
    effect_files: Sequence[str | Path] = (),
    keep_effects: bool = False,
    validation: str | None = None,
    hold_out: str | None = None,
    mapping: str | Path | None = None,
    system: int | None = None,
    seed: int = 0,
    ensemble: int = 4,
    jobs: int | None = None,
    device: str = "cpu",
    resume: bool = False,
    overwrite: bool = False,
    progress: Callable[[Report], None] | None = None,
) -> TrainingResult:
    """Train a model of a vehicle's accelerations from its flights, and write it as a checkpoint with its card.

    A script that calls this with more than one member must do so below `if __name__ == "__main__":`.

    logs: paths, folders of logs, or the folder of a campaign, for its training flights.
    vehicle: vehicle file, or the name of a bundled one.
    model: what to train: "pi_tcn", "grey_box", "nominal", ...; see `alula train --help`.
    out: checkpoint to write (.pt); its card lies beside it (.json).
    recipe: how to train: "fast" or "paper".
    config: fields of the model's definition that differ, such as {"history": 10}.
    overrides: fields of the recipe that differ, such as {"steps": 2000}.
    added_effects: beside the vehicle file's, "name" or "name:key=value,..."; "diagnosed" for all that a diagnosis of
        the training flights names.
    effect_files: Python files with effects of your own, beside those that the vehicle names.
    keep_effects: leave the vehicle file's effects as they are, instead of fitting them to these flights.
    validation: pattern of the file names to choose the best step by; by default every tenth flight.
    hold_out: pattern of the file names not to read at all.
    mapping: column mapping (TOML) for CSV files of another tool.
    system: as of `read_flight`.
    seed: seed of the first member; the others follow.
    ensemble: members.
    jobs: processes; by default one a core.
    device: "cpu", "cuda" or "cuda:1".
    resume: continue a training that was interrupted.
    overwrite: replace an existing checkpoint.
    progress: called with the losses of a member at each of its evaluations.

    Returns a TrainingResult.
    Raises RequestError for options that make no sense, DataError for flights that hold too little.

    Example:
        result = alula.train("logs", "arpl_250g", model="pi_tcn", out="pi_tcn.pt", overrides={"steps": 2000})
        print([error.combined / error.nominal for error in result.report.errors])
    """
    with workbench("alula.train"):
        from training.run import TrainOptions, run
    approve_given(effect_files)
    options = TrainOptions(
        logs=_paths(logs),
        vehicle=str(vehicle),
        model=model,
        out=Path(out),
        recipe=recipe,
        config=dict(config or {}),
        recipe_overrides=dict(overrides or {}),
        effects=tuple(added_effects),
        effect_files=tuple(Path(path).resolve() for path in effect_files),
        keep_effects=keep_effects,
        validation=validation,
        hold_out=hold_out,
        mapping=None if mapping is None else Path(mapping),
        seed=seed,
        ensemble=ensemble,
        jobs=jobs,
        device=device,
        resume=resume,
        overwrite=overwrite,
    )
    with system_chosen(system):
        trained = run(options, progress or _ignore)
    return TrainingResult(trained.card, trained, options.out)


def evaluate(
    models: str | Path | Sequence[str | Path],
    logs: str | Path | Sequence[str | Path],
    *,
    vehicle: str | Path | None = None,
    effect_files: Sequence[str | Path] = (),
    mapping: str | Path | None = None,
    system: int | None = None,
    timing: bool = False,
    progress: Callable[[str], None] | None = None,
) -> EvaluationResult:
    """Evaluate models on held-out flights; with a campaign's flights, against ground truth too.

    models: checkpoints (.pt).
    logs: paths, folders of logs, or the folder of a campaign, for its test flights.
    vehicle: vehicle file or name whose own model is evaluated beside the others.
    effect_files: Python files with effects of your own, beside those that the vehicle names.
    mapping: column mapping (TOML) for CSV files of another tool.
    system: as of `read_flight`.
    timing: measure how long a prediction takes.
    progress: called with each model's name when it is evaluated.

    Returns an EvaluationResult.
    Raises RequestError for models or logs that cannot be used, DataError for flights that hold too little.

    Example:
        result = alula.evaluate("pi_tcn.pt", "logs", vehicle="arpl_250g")
        print(*result.summary, sep="\\n")
    """
    with workbench("alula.evaluate"):
        from studies.evaluation.run import EvaluationAnswer, run
    approve_given(effect_files)
    with system_chosen(system):
        results = run(
            (*_paths(models), *_paths(logs)),
            None if vehicle is None else str(vehicle),
            mapping=None if mapping is None else Path(mapping),
            timed=timing,
            effect_files=_paths(effect_files),
            done=progress or _ignore,
        )
    return EvaluationResult(EvaluationAnswer(results.evaluated, results.timings), results.tables, results)


def export(
    model: str | Path,
    out: str | Path,
    *,
    effect_files: Sequence[str | Path] = (),
    logs: str | Path | Sequence[str | Path] = (),
    member: int = 0,
    processor: str = "native",
    integrator: Integrator | None = None,
    nodes: int | None = None,
    horizon: float | None = None,
    windows: int = 1000,
    seed: int = 0,
    overwrite: bool = False,
    flight_check: bool = True,
) -> ExportResult:
    """Write ONNX, C and the real-time kernel of a model, and prove that they compute what was trained.

    model: checkpoint (.pt), or a vehicle file or name for its physics.
    out: folder to write.
    effect_files: Python files with effects of your own, beside those that a vehicle file names; the bundle holds them.
    logs: flights whose windows the backends are compared on, or folders of them; by default the paper's references.
    member: member of an ensemble that flies.
    processor: instruction set of the kernel: "native", "avx512", "avx2", "sse2" or "neon"; one that this machine does
        not have is cross-compiled, see `verify`.
    integrator: "hold", "adams_bashforth" or "rk4"; by default what fits the model's labels.
    nodes: nodes of the horizon; by default those of the vehicle's [controller], 20.
    horizon: its length, s; by default the vehicle's, 1.
    windows: windows of each kind to compare on.
    seed: seed of the random windows.
    overwrite: replace an existing bundle.
    flight_check: fly a learned model for some seconds in simulation.

    Returns an ExportResult.
    Raises RequestError for a model or a folder that cannot be used, DataError when the backends disagree.

    Example:
        result = alula.export("arpl_250g", "bundle", windows=50)
        print(*result.summary, sep="\\n")
    """
    with workbench("alula.export"):
        from dynamics.vehicle_file import find_vehicle
        from export.bundle import ExportOptions, export_bundle
        from export.trained import read_model
        from runtime.control.rti.problem import Problem
        from runtime.control.rti.processor import named_processor
        from simulation.flight_check import check_bundle
    approve_given(effect_files)
    path = Path(model) if Path(model).suffix == ".pt" else find_vehicle(model)
    trained = read_model(path, member=member, integrator=integrator, effect_files=effect_files)
    problem = Problem.from_settings(trained.vehicle.controller)
    problem = msgspec.structs.replace(problem, nodes=nodes or problem.nodes, horizon=horizon or problem.horizon)
    options = ExportOptions(
        problem,
        named_processor(processor),
        tuple(log_paths(logs)) if logs else (),
        windows,
        seed,
        overwrite,
        command_line(),
    )
    exported = export_bundle(trained, Path(out), options)
    flown = flight_check and options.processor.runs_here
    check = check_bundle(exported.folder, exported.manifest) if flown else None
    of_nominal = None if trained.trained is None else trained.trained.card.of_nominal
    return ExportResult(exported.folder, exported.manifest, exported.parity, check, of_nominal)


def _paths(paths: str | Path | Sequence[str | Path]) -> tuple[Path, ...]:
    return (Path(paths),) if isinstance(paths, (str, Path)) else tuple(map(Path, paths))


def _ignore(_: object) -> None:
    """A progress callback that does nothing."""
