"""The paper's figures: predictions along a flight, RMSE of each axis stacked, heatmaps of defective priors."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from dynamics.arrays import Floats
from dynamics.errors import RequestError
from dynamics.files import write_whole
from dynamics.state import ATTITUDE
from training.data.features import world_accelerations
from training.evaluation import BASE, NOMINAL, PLANT, EvaluatedModel

COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#666666")  # Okabe and Ito
LETTERS, LEGEND_MARK = 16.0, 8  # of a legend: letters to an inch, and what an entry needs besides its name
SLICE = 3.0  # s of flight, as long as the paper's
AXES = (
    ("acceleration x, m/s²", 0), ("acceleration y, m/s²", 1), ("acceleration z, m/s²", 2),
    ("angular x, rad/s²", 3), ("angular y, rad/s²", 4), ("angular z, rad/s²", 5),
)  # fmt: skip
STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "svg.hashsalt": "alula"}
FORMATS = ("png", "pdf")


def prediction_figure(judged: Sequence[EvaluatedModel], flight: str) -> Figure:
    """A flight like the paper's Figure 5: left, the slice of NOM's largest error; right, RMSE of each axis, stacked."""
    shown = [one for one in judged if one.evaluation.name != PLANT and one.evaluation.kind != BASE]
    times, label, predictions = _common_rows(shown, flight)
    begin = _worst_slice(times, predictions[0] - label)
    inside = (times >= begin) & (times <= begin + SLICE)
    names = [one.evaluation.name for one in shown]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.5, 9.5), layout="constrained")
        grid = figure.subplots(6, 2, width_ratios=(3, 1), sharex="col")
        for (heading, axis), (left, right) in zip(AXES, grid, strict=True):
            left.plot(times[inside], label[inside, axis], color="black", linewidth=1.8, label="measured")
            for colour, name, body in zip(COLOURS, names, predictions, strict=False):
                left.plot(times[inside], body[inside, axis], color=colour, linewidth=0.9, label=name)
            left.set_ylabel(heading)
            _stacked(right, times, [np.abs(body[:, axis] - label[:, axis]) for body in predictions])
        grid[0, 0].set_title(f"{flight.split('.')[0]}: a slice")
        grid[0, 1].set_title("error by second, stacked")
        grid[-1, 0].set_xlabel("time, s")
        grid[-1, 1].set_xlabel("time, s")
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False)
    return figure


def bars_figure(ratios: Mapping[str, Sequence[float | None]], flights: Sequence[str], title: str) -> Figure:
    """Bars over flights, one colour a model. ratios: by model's name, as many as flights."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(max(5.0, 1.3 * len(flights)), 3.4), layout="constrained")
        axes = figure.subplots()
        width = 0.8 / max(1, len(ratios))
        for place, (name, values) in enumerate(ratios.items()):
            across = np.arange(len(flights)) + (place - 0.5 * (len(ratios) - 1)) * width
            heights = [np.nan if value is None else value for value in values]
            turn, colour = divmod(place, len(COLOURS))
            axes.bar(across, heights, width, label=name, color=COLOURS[colour], hatch="///" if turn else None)
        axes.set_xticks(range(len(flights)), flights, rotation=20, ha="right")
        axes.set(title=title, ylim=(0, None))
        columns = LETTERS * figure.get_figwidth() / max(LEGEND_MARK + len(name) for name in [*ratios, ""])
        figure.legend(loc="outside lower center", frameon=False, ncols=max(1, min(4, int(columns))))
    return figure


def heatmap_figure(
    grids: Mapping[str, Floats], along: tuple[str, Sequence[float]], up: tuple[str, Sequence[float]], unit: str
) -> Figure:
    """One heatmap a model on one scale of colours, like the paper's Figure 4; logarithmic, for NOM's errors are large.

    grids: (len(up), len(along)) by model's name, NaN where a cell is missing. along, up: the quantity and its factors.
    """
    finite = np.concatenate([grid[np.isfinite(grid)] for grid in grids.values()])
    if not len(finite):
        raise RequestError("no cell of this heatmap is finished yet. Continue with the same `alula sweep`.")
    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(3.4 * len(grids) + 0.8, 4.0), layout="constrained")
        row = figure.subplots(1, len(grids), sharey=True, squeeze=False)[0]
        for axes, (name, grid) in zip(row, grids.items(), strict=True):
            drawn = axes.imshow(grid, origin="lower", cmap="viridis_r", norm=LogNorm(finite.min(), finite.max()))
            for (y, x), value in np.ndenumerate(grid):
                if np.isfinite(value):
                    dark = value > np.sqrt(finite.min() * finite.max())
                    axes.text(x, y, f"{value:.2f}", ha="center", va="center", color="white" if dark else "black")
            axes.set_xticks(range(len(along[1])), [f"{factor:g}" for factor in along[1]])
            axes.set_yticks(range(len(up[1])), [f"{factor:g}" for factor in up[1]])
            axes.set(title=name, xlabel=f"{along[0]} over the file's")
        row[0].set_ylabel(f"{up[0]} over the file's")
        bar = figure.colorbar(drawn, ax=list(row), label=unit)
        for axis_format in (bar.ax.yaxis.set_major_formatter, bar.ax.yaxis.set_minor_formatter):
            axis_format("{x:.2g}")
    return figure


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write NAME.png and NAME.pdf. Raises RequestError when the folder cannot be written to."""

    def write(kind: str, part: Path) -> None:
        part.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(part, format=kind, dpi=130, metadata={"CreationDate": None} if kind == "pdf" else None)

    return [
        write_whole(folder / f"{name}.{kind}", partial(write, kind), advice="Give another --pictures.")
        for kind in FORMATS
    ]


def nominal_ratios(judged: Sequence[EvaluatedModel]) -> tuple[dict[str, list[float | None]], list[str]]:
    """RMSE over NOM's by learned model and flight, against ground truth or else labels; and the flights' names."""
    flights = [error.flight for error in judged[0].evaluation.best_known]
    ratios: dict[str, list[float | None]] = {}
    for one in judged:
        if one.evaluation.name in (NOMINAL, PLANT) or one.evaluation.kind == BASE:
            continue
        by_flight = {error.flight: error.combined / error.nominal for error in one.evaluation.best_known}
        ratios[one.evaluation.name] = [by_flight.get(flight) for flight in flights]
    return ratios, [flight.split(".")[0] for flight in flights]


def _common_rows(judged: Sequence[EvaluatedModel], flight: str) -> tuple[Floats, Floats, list[Floats]]:
    """Times, labels (n, 6) and predictions in world axes of the rows of a flight that every model has."""
    times, parts = [], []
    for one in judged:
        data, ends = one.data, one.data.ends
        rows = np.flatnonzero(data.flight_of[ends] == data.flights.index(flight))
        attitude = data.state[ends[rows], ATTITUDE]
        world = [world_accelerations(body, attitude) for body in (data.label[ends[rows]], one.body[rows])]
        times.append(np.round(data.time[ends[rows]], 6))
        parts.append(world)
    shared = times[0]
    for other in times[1:]:
        shared = np.intersect1d(shared, other)
    chosen = [np.searchsorted(time, shared) for time in times]
    label = parts[-1][0][chosen[-1]]
    return shared, label, [part[1][rows] for part, rows in zip(parts, chosen, strict=True)]


def _worst_slice(times: Floats, error: Floats) -> float:
    """Start of the slice in which NOM's squared error is largest."""
    size = np.concatenate([[0.0], np.cumsum(np.sum(error**2, axis=1))])
    ends = np.searchsorted(times, times + SLICE)
    return float(times[int(np.argmax(size[ends] - size[:-1]))])


def _stacked(axes: Any, times: Floats, errors: Sequence[Floats]) -> None:
    """RMSE by second, stacked, so that no model hides another."""
    edges = np.arange(times[0], times[-1] + 1.0, 1.0)
    which = np.digitize(times, edges) - 1
    rows = np.maximum(np.bincount(which, minlength=len(edges)), 1)
    heights = [np.sqrt(np.bincount(which, error**2, minlength=len(edges)) / rows) for error in errors]
    axes.stackplot(edges, *heights, colors=COLOURS[: len(heights)], linewidth=0, step="post")
    axes.set_ylim(0, None)


def as_png(figure: Figure) -> bytes:
    """A picture for a page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()
