"""Style of all pictures: colours for the colour-blind, axes with units, lines thinned for the screen."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from dynamics.arrays import Floats
from studio.pages.colours import (
    AFTER,
    AXIS,
    BEFORE,
    BLACK,
    BLUE,
    FLOOR,
    GREEN,
    GRID,
    MEASURED,
    ORANGE,
    PAPER,
    PURPLE,
    SKY,
    TEXT,
    UNFLOWN,
    VERMILION,
    YELLOW,
)
from studio.pages.page import embedded

__all__ = [
    "AFTER",
    "BEFORE",
    "BLACK",
    "BLUE",
    "FLOOR",
    "GREEN",
    "GRID",
    "MAX_POINTS",
    "MEASURED",
    "ORANGE",
    "PURPLE",
    "SKY",
    "UNFLOWN",
    "VERMILION",
    "YELLOW",
    "Choice",
    "Picture",
    "choosing",
    "line",
    "picture",
    "thinned",
]


MAX_POINTS = 3000  # of a line


@dataclass(frozen=True)
class Picture:
    """A figure as JSON that a page draws.

    data: the JSON.
    height: px.
    description: what it shows, for screen readers.
    """

    data: str
    height: int
    description: str


@dataclass(frozen=True)
class Choice:
    """Entry of a picture's menu: the places of its lines, and changes of layout such as a unit."""

    name: str
    lines: Collection[int]
    layout: Mapping[str, Any] = field(default_factory=dict)


def picture(
    figure: go.Figure,
    height: int,
    description: str,
    *,
    titles: bool = False,
    legends: Callable[[go.Figure], go.Figure] = lambda figure: figure,
) -> Picture:
    """A figure in the style of all pages.

    titles: whether its parts have titles, above which the legend is placed. legends: places them where there are more.
    """
    head, foot = (74 if titles else 34), 48
    above = 1 + (26 / (height - head - foot) if titles else 0)
    figure.update_layout(
        template="none",
        height=height,
        margin={"l": 62, "r": 12, "t": head, "b": foot},
        font={"size": 12, "family": "system-ui, sans-serif", "color": TEXT},
        hoverlabel={"font_size": 12},
        paper_bgcolor=PAPER,
        plot_bgcolor=figure.layout.plot_bgcolor or PAPER,
        modebar={"bgcolor": "rgba(0,0,0,0)", "color": FLOOR, "activecolor": TEXT},
        legend={"orientation": "h", "x": 0, "y": above, "yanchor": "bottom"},
    )
    figure.update_xaxes(gridcolor=GRID, zeroline=False, linecolor=AXIS, title_standoff=6)
    figure.update_yaxes(gridcolor=GRID, zeroline=False, linecolor=AXIS, title_standoff=6)
    legends(figure)
    return Picture(embedded(figure.to_json(engine="json")), height, description)


def line(x: Floats, y: Floats, *, name: str, colour: str, unit: str, **more: Any) -> go.Scatter:
    """A line whose values show under the pointer; single precision, which is enough for a screen."""
    return go.Scatter(
        x=x.astype(np.float32),
        y=y.astype(np.float32),
        name=name,
        mode="lines",
        line={"color": colour, "width": more.pop("width", 1.4), "dash": more.pop("dash", "solid")},
        hovertemplate=f"{name}: %{{y:.3g}} {unit}<extra></extra>",
        **more,
    )


def thinned(lines: Sequence[Floats], max_points: int = MAX_POINTS) -> NDArray[np.intp]:
    """Rows that draw lines (n,) of one clock so that every spike still shows: minimum and maximum of many parts."""
    rows = len(lines[0])
    if rows <= max_points:
        return np.arange(rows)
    parts = max(1, max_points // (2 * len(lines)))
    edges = np.linspace(0, rows, parts + 1).astype(int)
    drawn = {0, rows - 1}
    for values, (start, stop) in ((v, e) for v in lines for e in pairwise(edges)):
        part = values[start:stop]
        if np.isfinite(part).any():
            drawn |= {start + int(np.nanargmin(part)), start + int(np.nanargmax(part))}
    return np.array(sorted(drawn))


def choosing(figure: go.Figure, choices: Sequence[Choice], *, label: str) -> None:
    """Let the page choose which lines of a figure show; initially the first choice."""
    figure.update_layout(
        meta={
            "label": label,
            "choices": [
                {
                    "name": c.name,
                    "visible": [index in c.lines for index in range(len(figure.data))],
                    "layout": dict(c.layout),
                }
                for c in choices
            ],
        }
    )
    for index, trace in enumerate(figure.data):
        trace.visible = index in choices[0].lines
