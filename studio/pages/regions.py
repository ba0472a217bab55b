"""Maps of where a model fails: error over noise floor in cells of one and of two quantities; unflown cells are grey."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import plotly.graph_objects as go

from diagnosis.models.channels import KINDS, NAMES
from diagnosis.regimes import Plane, Regime
from dynamics.arrays import Floats
from studio.pages.figure import UNFLOWN, Choice, Picture, choosing, picture
from studio.pages.numbers import quantity_shown

SCALE = "Cividis"


def regime_map(maps: Sequence[Regime]) -> Picture:
    """A row for each quantity, its cells from the lowest to the highest value that was flown."""
    figure, choices = go.Figure(), []
    names = [quantity_shown(regime.name) for regime in maps]
    for kind, top in _kinds([regime.over_floor for regime in maps]):
        values = np.array([regime.over_floor[kind] for regime in maps])
        ranges = [[f"{low:.3g} to {high:.3g}" for low, high in pairwise(regime.edges)] for regime in maps]
        choices.append(Choice(NAMES[KINDS[kind]], [len(figure.data)]))
        figure.add_trace(
            go.Heatmap(
                z=values,
                y=names,
                x=[f"{cell + 1}" for cell in range(values.shape[1])],
                customdata=ranges,
                **_colours(top),
                text=_labels(values),
                texttemplate="%{text}",
                hovertemplate="%{y} from %{customdata}: %{z:.3g} times the floor<extra></extra>",
            )
        )
    choosing(figure, choices, label="channel")
    figure.update_layout(plot_bgcolor=UNFLOWN)
    figure.update_xaxes(title_text=f"low to high, in {len(maps[0].edges) - 1} equal parts", type="category")
    figure.update_yaxes(automargin=True, autorange="reversed")
    return picture(figure, 110 + 34 * len(maps), "Map: error over floor along each quantity.")


def plane_map(plane: Plane) -> Picture:
    """Error over floor in cells of two quantities."""
    figure, choices = go.Figure(), []
    for kind, top in _kinds([plane.over_floor]):
        values = plane.over_floor[kind]
        choices.append(Choice(NAMES[KINDS[kind]], [len(figure.data)]))
        figure.add_trace(
            go.Heatmap(
                z=values,
                x=_middles(plane.across_edges),
                y=_middles(plane.up_edges),
                text=_labels(values),
                texttemplate="%{text}",
                **_colours(top),
                hovertemplate="%{x:.3g}, %{y:.3g}: %{z:.3g} times the floor<extra></extra>",
            )
        )
    choosing(figure, choices, label="channel")
    figure.update_layout(plot_bgcolor=UNFLOWN)
    figure.update_xaxes(title_text=quantity_shown(plane.across), showgrid=False, nticks=6)
    figure.update_yaxes(title_text=quantity_shown(plane.up), showgrid=False, nticks=6)
    return picture(figure, 360, f"Map: error over floor by {plane.across} and {plane.up}.")


def _kinds(tables: Sequence[Floats]) -> list[tuple[int, float]]:
    """The kinds of channel that there are with their greatest value, the worst first."""
    kinds = []
    for kind in range(len(KINDS)):
        values = np.concatenate([table[kind].ravel() for table in tables])
        if np.isfinite(values).any():
            kinds.append((kind, float(np.nanmax(values))))
    return sorted(kinds, key=lambda pair: -pair[1])


def _colours(top: float) -> dict[str, Any]:
    return {
        "colorscale": SCALE,
        "zmin": 1.0,
        "zmax": max(2.0, top),
        "xgap": 1,
        "ygap": 1,
        "colorbar": {"title": "times<br>floor", "thickness": 12},
    }


def _labels(values: Floats) -> list[list[str]]:
    return [[f"{value:.1f}" if np.isfinite(value) else "" for value in row] for row in values]


def _middles(edges: Floats) -> Floats:
    return np.asarray((edges[1:] + edges[:-1]) / 2)
