"""Pictures of a study: heatmaps of defective priors, curves, bars by flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from dynamics.arrays import Floats
from studies import figures, paper
from studies.sweep.cell import CellResult, grouped
from studies.sweep.curves import ErrorCurve, history_figure, lambda_figure, search_figure
from training.prediction import pooled

HEATMAPS = {"inertia": ("Jxx", "Jzz"), "rotors": ("k_f", "k_tau")}
SYMBOLS = {"Jxx": "$J_{xx}$", "Jzz": "$J_{zz}$", "k_f": "$k_f$", "k_tau": "$k_\\tau$"}
MODELS = {"res_tcn": "RES-TCN", "pi_tcn": "PI-TCN"}


def study_figures(study: str, along: Sequence[str], results: Sequence[CellResult]) -> list[tuple[str, Figure, str]]:
    """Name, picture and caption of each picture of a study; none without a result."""
    if not results:
        return []
    if study in HEATMAPS:
        caption = "RMSE of each model for each wrong prior, as the paper's heatmaps: factors on the file's constants"
        return [(study, _heatmap(study, results), caption)]
    if study == "search":
        return [(f"search_{name}", _searched(name, results), f"Validation error over {name}") for name in along]
    bars = (f"{study}_flights", _bars(study, along, results), "RMSE over NOM's by test flight, mean of the seeds")
    if study == "lambda" and any(float(result.cell.at["lambda"]) == 0 for result in results):
        caption = "RMSE over lambda; the band is lambda = 0, plus and minus its seeds' deviation"
        return [(study, _lambda(results), caption), bars]
    if study == "history":
        return [(study, _history(results), "RMSE and inference time over the history's length"), bars]
    return [(study, *bars[1:])]


def heatmaps(study: str, results: Sequence[CellResult]) -> dict[str, Floats]:
    """RMSE of each model over the factors of the second quantity (rows) and the first, NaN where there is none."""
    first, second = HEATMAPS[study]
    along, up = (factors_of(name, results) for name in (first, second))
    grids = {name: np.full((len(up), len(along)), np.nan) for name in ("NOM", *MODELS.values())}
    for (model, x, y), members in grouped(results, "model", first, second).items():
        at = up.index(float(y)), along.index(float(x))
        errors = [pooled(result.best_known) for result in members]
        grids[MODELS[str(model)]][at] = np.mean([error.combined for error in errors])
        grids["NOM"][at] = np.mean([error.nominal for error in errors])
    return grids


def factors_of(name: str, results: Sequence[CellResult]) -> list[float]:
    """The factors on a quantity that have results, ascending."""
    return sorted({float(result.cell.at[name]) for result in results})


def _heatmap(study: str, results: Sequence[CellResult]) -> Figure:
    along, up = ((SYMBOLS[name], factors_of(name, results)) for name in HEATMAPS[study])
    return figures.heatmap_figure(heatmaps(study, results), along, up, "RMSE")


def _bars(study: str, along: Sequence[str], results: Sequence[CellResult]) -> Figure:
    flights = [error.flight.split(".")[0] for error in results[0].best_known]
    bars = {
        _words(along, place): np.mean(
            [[error.combined / error.nominal for error in result.best_known] for result in members], axis=0
        )
        for place, members in grouped(results, *along).items()
    }
    return figures.bars_figure(bars, flights, f"{study}: RMSE over NOM's")


def _words(along: Sequence[str], place: Sequence[float | str]) -> str:
    return ", ".join(
        f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
        for key, value in zip(along, place, strict=True)
    )


def _lambda(results: Sequence[CellResult]) -> Figure:
    curves: dict[str, ErrorCurve] = {}
    without = (np.nan, np.nan)
    for (points,), members in grouped(results, "points").items():
        by_weight = {float(weight): cells for (weight,), cells in grouped(members, "lambda").items()}
        if 0.0 in by_weight:
            zero = _curve({0.0: by_weight.pop(0.0)})
            without = zero.values[0], zero.deviation[0]
        curves[f"{points} points"] = _curve(by_weight)
    return lambda_figure(curves, without)


def _history(results: Sequence[CellResult]) -> Figure:
    lengths = {float(length): members for (length,), members in grouped(results, "history").items()}
    lengths = {length: lengths[length] for length in sorted(lengths)}
    milliseconds = [1000 * float(np.median([one.inference for one in members])) for members in lengths.values()]
    return history_figure(_curve(lengths), milliseconds, {float(key): value for key, value in paper.HISTORY.items()})


def _curve(places: Mapping[float, Sequence[CellResult]]) -> ErrorCurve:
    errors = [[pooled(result.best_known).combined for result in members] for members in places.values()]
    deviation = [float(np.std(values, ddof=1)) if len(values) > 1 else 0.0 for values in errors]
    return ErrorCurve(list(places), [float(np.mean(values)) for values in errors], deviation)


def _searched(name: str, results: Sequence[CellResult]) -> Figure:
    tried = [float(result.cell.at[name]) for result in results]
    return search_figure(name, tried, [result.validation for result in results])
