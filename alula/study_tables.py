"""What a study found as tables and pictures, beside the paper's own figures where it has them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from alula import paper
from alula.tables import Cell, Table
from training import figures
from training.prediction import pooled
from training.studies import FACTORS
from training.studies.cell import CellResult, grouped

HEATMAPS = {"inertia": ("Jxx", "Jzz"), "rotors": ("k_f", "k_tau")}


def study_table(study: str, along: Sequence[str], results: Sequence[CellResult]) -> Table:
    """A row for each place of the study: RMSE of the seeds, mean and deviation, and the paper's figure."""
    rows = []
    for place, members in grouped(results, *along).items():
        best = [pooled(result.best_known) for result in members]
        both = np.array([error.combined for error in best])
        label = np.array([pooled(result.label).combined for result in members])
        flights = np.mean([[e.combined for e in result.best_known] for result in members], axis=0)
        rows.append((
            *place, float(both.mean()), float(both.std(ddof=1)) if len(both) > 1 else None,
            float(np.mean([error.linear for error in best])), float(np.mean([error.angular for error in best])),
            float(label.mean()), float(np.mean([error.combined / error.nominal for error in best])),
            float(flights.std()), float(1000 * np.median([result.inference for result in members])),
            float(np.mean([result.seconds for result in members])), len(members), *_papers(study, place),
        ))  # fmt: skip
    truth = "the truth" if results and results[0].true else "labels"
    headings = (
        *along, "RMSE", "± seeds", "m/s²", "rad/s²", "against labels", "/ NOM", "± flights", "inference ms",
        "training s", "seeds", *PAPER_HEADINGS.get(study, ()),
    )  # fmt: skip
    note = f"RMSE on the test flights against {truth}, linear and angular alike, all flights as one."
    return Table(study, f"Study: {study}", headings, tuple(rows), note)


PAPER_HEADINGS = {
    "ablation": ("paper RMSE", "paper ±"),
    "history": ("paper RMSE", "paper ±", "paper ms"),
}


def _papers(study: str, place: tuple[float | str, ...]) -> tuple[Cell, ...]:
    if study == "ablation":
        return paper.ABLATION[place[0] == "yes", place[1] == "yes"]
    if study == "history":
        milliseconds, rmse, deviation = paper.HISTORY[int(place[0])]
        return rmse, deviation, milliseconds
    return ()


def heatmaps(study: str, results: Sequence[CellResult]) -> dict[str, NDArray[np.float64]]:
    """(5, 5) RMSE of NOM, RES-TCN and PI-TCN over the factors of the second quantity (rows) and the first."""
    first, second = HEATMAPS[study]
    grids = {name: np.full((len(FACTORS), len(FACTORS)), np.nan) for name in ("NOM", "RES-TCN", "PI-TCN")}
    for (model, x, y), members in grouped(results, "model", first, second).items():
        at = FACTORS.index(float(y)), FACTORS.index(float(x))
        errors = [pooled(result.best_known) for result in members]
        grids["RES-TCN" if model == "res_tcn" else "PI-TCN"][at] = np.mean([error.combined for error in errors])
        grids["NOM"][at] = np.mean([error.nominal for error in errors])
    return grids


def study_figure(study: str, along: Sequence[str], results: Sequence[CellResult]) -> Figure:
    """Heatmaps for the defective priors, else bars of RMSE over NOM's by flight."""
    if study in HEATMAPS:
        first, second = HEATMAPS[study]
        return figures.heatmap_figure(heatmaps(study, results), (first, FACTORS), (second, FACTORS), "RMSE")
    flights = [error.flight for error in results[0].best_known]
    bars = {
        ", ".join(f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
                  for key, value in zip(along, place, strict=True)):
        np.mean([[error.combined / error.nominal for error in result.best_known] for result in members], axis=0)
        for place, members in grouped(results, *along).items()
    }  # fmt: skip
    return figures.bars_figure(bars, [flight.split(".")[0] for flight in flights], f"{study}: RMSE over NOM's")


def search_table(names: Sequence[str], results: Sequence[CellResult]) -> Table:
    """Trials, the best on the validation flights first."""
    ordered = sorted(results, key=lambda result: result.validation)
    rows = tuple(
        (result.cell.name, *(result.cell.at[name] for name in names), result.validation,
         pooled(result.best_known).combined)
        for result in ordered
    )  # fmt: skip
    note = "Chosen by the validation flights; what the test flights say of it stands beside it."
    return Table("search", "Search", ("trial", *names, "validation", "test RMSE"), rows, note)
