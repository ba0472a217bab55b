"""An evaluation's JSON: errors of each model on held-out flights."""

from __future__ import annotations

from pathlib import Path

import msgspec
import plotly.graph_objects as go

from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from dynamics.field_errors import described
from studies.evaluation.run import EvaluationAnswer
from studies.evaluation.tables import evaluation_tables, summary_lines
from studies.results.kinds import EVALUATION
from studies.tables_page import as_page_table
from studio.pages.figure import AFTER, GREEN, ORANGE, PURPLE, SKY, VERMILION, Picture, picture
from studio.pages.shown import Shown
from training.evaluation import NOMINAL, PLANT, EvaluationReport

COLOURS = (AFTER, ORANGE, GREEN, PURPLE, SKY, VERMILION)


def show(path: Path) -> Shown:
    """The evaluation. Raises RequestError for a file of another version."""
    try:
        answer = decode_json(path.read_bytes(), EvaluationAnswer)
    except (OSError, msgspec.MsgspecError) as error:
        raise RequestError(
            f"{path} is no evaluation that this version reads: {described(error)}. Evaluate again."
        ) from error
    report = answer.evaluated
    tables = evaluation_tables(report, answer.inference)
    return Shown(
        EVALUATION,
        "Flight models on held-out flights",
        summary_lines(report),
        pictures=_pictures(report),
        tables=[as_page_table(table) for table in tables],
    )


def _pictures(report: EvaluationReport) -> dict[str, Picture]:
    """RMSE over the nominal model's by flight, and open-loop errors."""
    figure = go.Figure()
    models = [model for model in report.models if model.name not in (NOMINAL, PLANT)]
    for model, colour in zip(models, COLOURS * len(models), strict=False):
        errors = model.true or model.label
        figure.add_trace(
            go.Bar(
                x=[Path(e.flight).stem for e in errors],
                y=[e.combined / e.nominal for e in errors],
                name=model.name,
                marker_color=colour,
                hovertemplate=f"{model.name}, %{{x}}: %{{y:.3g}} of NOM's<extra></extra>",
            )
        )
    figure.update_yaxes(title_text="RMSE / NOM's", rangemode="tozero")
    figure.update_xaxes(automargin=True)
    pictures = {"Error by flight": picture(figure, 380, "Bars: RMSE over the nominal model's, by flight and model.")}
    if any(model.open_loop for model in report.models):
        pictures["Open loop"] = _open_loop(report)
    return pictures


def _open_loop(report: EvaluationReport) -> Picture:
    figure = go.Figure()
    for model, colour in zip(report.models, COLOURS * len(report.models), strict=False):
        figure.add_trace(
            go.Scatter(
                x=[error.horizon for error in model.open_loop],
                y=[error.position for error in model.open_loop],
                name=model.name,
                mode="lines+markers",
                line={"color": colour},
            )
        )
    figure.update_xaxes(title_text="horizon, s", type="log")
    figure.update_yaxes(title_text="RMS position error, m", type="log", exponentformat="power")
    return picture(figure, 380, "Lines: position error of each model run by itself, over the horizon.")
