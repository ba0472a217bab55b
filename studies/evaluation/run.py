"""An evaluation from command-line arguments: models, flights, and the outputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
from matplotlib.figure import Figure

from dynamics.errors import RequestError
from dynamics.references.campaign import paper_campaign
from dynamics.vehicle_file import find_vehicle, read_vehicle
from flights.folder import CAMPAIGN
from studies import figures
from studies.evaluation.inference import Inference, time_inference
from studies.evaluation.tables import evaluation_tables, summary_lines
from studies.tables import Table
from studies.tables_page import write_tables_page
from training import checkpoint
from training.config import physical_config
from training.data.logged_flights import find_logs, left_out, read_logged_flights
from training.evaluation import (
    PLANT,
    VEHICLE_FILE,
    EvaluatedModel,
    EvaluationReport,
    NamedModel,
    evaluate,
    physical_model,
)
from training.ground_truth import campaign_of

MODEL_SUFFIX = ".pt"
MAX_PICTURES = 8  # flights


@dataclass(frozen=True, eq=False)
class Results:
    """Results of an evaluation: numbers, tables, and what the pictures need."""

    evaluated: EvaluationReport
    timings: tuple[Inference, ...]
    tables: tuple[Table, ...]
    judged: tuple[EvaluatedModel, ...]


class EvaluationAnswer(msgspec.Struct, frozen=True):
    """`alula evaluate --json`."""

    evaluated: EvaluationReport
    inference: tuple[Inference, ...]


def run(
    arguments: Sequence[Path],
    vehicle: str | None,
    *,
    mapping: Path | None,
    timed: bool,
    done: Callable[[str], None],
    effect_files: Sequence[Path] = (),
) -> Results:
    """Evaluate models on flights.

    arguments: checkpoints (.pt) and flights in any order.
    vehicle: a vehicle file to evaluate as well.
    timed: whether to time inference.
    done: called with each model's name.
    effect_files: with effects of the user's own, beside those that the vehicle names.

    Raises RequestError and DataError for what a user can cause.
    """
    paths = [path for path in arguments if path.suffix == MODEL_SUFFIX]
    models = [NamedModel(name, checkpoint.load(path)) for name, path in zip(_names(paths), paths, strict=True)]
    logs = find_flights([path for path in arguments if path.suffix != MODEL_SUFFIX])
    if vehicle is not None:
        file = read_vehicle(find_vehicle(vehicle), effect_files=effect_files)
        like = models[0].model.config if models else physical_config(VEHICLE_FILE, rotors=file.rotors.count)
        models.insert(0, NamedModel(VEHICLE_FILE, physical_model(VEHICLE_FILE, file, like)))
    dt = models[0].model.config.dt if models else physical_config("", rotors=4).dt
    if any(named.model.config.dt != dt for named in models):
        raise RequestError("the models predict over different times dt: evaluate them one at a time.")
    recordings = read_logged_flights(logs, dt=dt, mapping=mapping, may_be_tests=True)
    evaluated, judged = evaluate(models, recordings, campaign=campaign_of(logs), done=done)
    timings, missing = time_inference(judged) if timed else ((), ())
    notes = (*left_out(logs, recordings), *evaluated.notes, *missing)
    evaluated = msgspec.structs.replace(evaluated, notes=notes)
    return Results(evaluated, timings, evaluation_tables(evaluated, timings), judged)


def find_flights(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Logs of these paths: files as they are, of a campaign's folder its test flights, of other folders all files.

    Raises RequestError for a missing path.
    """
    logs: list[Path] = []
    for path in paths:
        is_campaign = path.is_dir() and (path / CAMPAIGN).exists()
        logs += find_logs([path / "test" if is_campaign else path])
    if not logs:
        raise RequestError("no flight was given. Give logs, a folder of logs, or a campaign's folder.")
    order = {flight.name: place for place, flight in enumerate(paper_campaign())}
    return tuple(sorted(logs, key=lambda path: order.get(path.stem, len(order))))


def draw(results: Results, folder: Path) -> list[Path]:
    """RMSE over NOM's by flight, and predictions along each flight, PNG and PDF."""
    written = []
    for name, figure, _ in _figures(results):
        written += figures.save(figure, folder, name)
    return written


def write_html(results: Results, path: Path) -> None:
    """Tables and pictures in one file. Raises RequestError when it cannot be written."""
    pictures = [(figure, caption) for _, figure, caption in _figures(results)]
    title = "Flight models on held-out flights"
    lines, flights = summary_lines(results.evaluated), results.evaluated.flights
    write_tables_page(path, title, lines, results.tables, pictures, inputs=flights)


def _figures(results: Results) -> list[tuple[str, Figure, str]]:
    ratios, flights = figures.nominal_ratios(results.judged)
    pictures = []
    if ratios:
        title = "RMSE over NOM's"
        pictures.append(("rmse_over_nominal", figures.bars_figure(ratios, flights, title), f"{title}, by flight"))
    shown = [one for one in results.judged if one.evaluation.name != PLANT]
    for error in results.judged[0].evaluation.label[:MAX_PICTURES]:
        if all(error.flight in [e.flight for e in one.evaluation.label] for one in shown):
            name = Path(error.flight).stem
            figure = figures.prediction_figure(shown, error.flight)
            pictures.append((f"prediction_{name}", figure, f"Predictions along {name}, and the error second by second"))
    return pictures


def _names(paths: Sequence[Path]) -> list[str]:
    """Short unique names of the files. Raises RequestError for a file given twice."""
    if len(set(paths)) < len(paths):
        raise RequestError("a model is given twice. Give each once.")
    stems = [path.stem for path in paths]
    kinds = [stem.split(".")[-1] for stem in stems]
    for names in (kinds, stems):
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in paths]
