"""Pictures of studies along a number: lambda, the history's length, the values of a search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.figures import COLOURS, STYLE

PAPERS = {"color": "#666666", "linestyle": "--", "linewidth": 1.0, "marker": "s", "markersize": 4}


@dataclass(frozen=True)
class ErrorCurve:
    """Errors along a number.

    places: the number's values.
    values: errors there.
    deviation: standard deviation over the seeds; 0 with one seed.
    """

    places: Sequence[float]
    values: Sequence[float]
    deviation: Sequence[float]


def lambda_figure(curves: Mapping[str, ErrorCurve], without: tuple[float, float]) -> Figure:
    """RMSE over lambda, a curve for each kind of points. without: RMSE and its deviation at lambda = 0, a band."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.6, 3.8), layout="constrained")
        axes = figure.subplots()
        axes.axhline(without[0], color="black", linewidth=1.0, label="λ = 0")
        axes.axhspan(without[0] - without[1], without[0] + without[1], color="black", alpha=0.12, linewidth=0)
        for colour, (name, curve) in zip(COLOURS, curves.items(), strict=False):
            _draw(axes, curve, colour, name)
        axes.set(xscale="log", yscale="log", xlabel="λ, weight of the physics-inspired loss", ylabel="RMSE")
        axes.set_title("The physics-inspired loss, by its weight and points")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:.2g}")
        axes.legend(frameon=False)
    return figure


def history_figure(
    rmse: ErrorCurve, milliseconds: Sequence[float], paper: Mapping[float, tuple[float, float, float]]
) -> Figure:
    """RMSE and time of one prediction over the history's length, each beside the paper's.

    paper: by columns, milliseconds, RMSE and its deviation over the flights.
    """
    shown = [length for length in rmse.places if length in paper]
    at = {length: place for place, length in enumerate(rmse.places)}
    placed = ErrorCurve(list(at.values()), rmse.values, rmse.deviation)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.4, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        _draw(left, placed, COLOURS[1], "here, ± seeds")
        right.plot(placed.places, milliseconds, "o-", color=COLOURS[1], label="here, torch, one thread")
        for axes, which in ((left, 1), (right, 0)):
            axes.plot(
                [at[length] for length in shown],
                [paper[length][which] for length in shown],
                label="the paper's",
                **PAPERS,
            )
            axes.set_xticks(list(at.values()), [f"{length:g}" for length in at])
            axes.set_xlabel("past columns of 10 ms")
            axes.set_ylim(0, None)
            axes.legend(frameon=False)
        left.set(title="Error by length of the history", ylabel="RMSE")
        right.set(title="Time of one prediction", ylabel="ms")
    return figure


def search_figure(name: str, tried: Sequence[float], validation: Sequence[float]) -> Figure:
    """Validation error over the values that a search tried."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.6, 3.8), layout="constrained")
        axes = figure.subplots()
        axes.plot(tried, validation, "o", color=COLOURS[1])
        axes.set(xscale="log", yscale="log", xlabel=name, ylabel="validation error, squared, standardised")
        axes.set_title(f"Search over {name}")
    return figure


def _draw(axes: Axes, curve: ErrorCurve, colour: str, label: str) -> None:
    axes.errorbar(
        curve.places, curve.values, yerr=curve.deviation, color=colour, marker="o", markersize=4, capsize=3, label=label
    )
