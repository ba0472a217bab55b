"""New points for lines that are drawn already, which is all that a zoom or a slider sends.

The browser puts them in the lines' places, unless other lines have been drawn there in the meantime: each drawn figure
has a key in its layout's `meta`, and points of another key are dropped.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import dash
import numpy as np
import plotly.graph_objects as go
from dash import ClientsideFunction, Input, dcc, html
from numpy.typing import NDArray

from studio.app.parts import graph
from studio.app.theme import EMPTY
from studio.app.traces import Line


def lines_graph(name: str, description: str, height: int) -> Any:
    """A picture of lines that can be redrawn, empty at first. height: px."""
    return html.Div([graph(name, EMPTY, description, height=height), dcc.Store(id=points_of(name))])


def points_of(name: str) -> str:
    """Where the new points of a picture's lines are sent."""
    return f"{name}-points"


def register(app: dash.Dash, name: str) -> None:
    """The browser's part."""
    app.clientside_callback(ClientsideFunction("studio", "redraw"), Input(points_of(name), "data"))


def keyed(figure: go.Figure, key: str) -> go.Figure:
    """A figure whose lines can be redrawn by points of the same key."""
    figure.update_layout(meta={"lines": key})
    return figure


def redrawn(name: str, key: str, lines: Mapping[int, Line], layout: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """New points for lines of a picture, by their places in it. layout: what changes in the figure's layout, too."""
    return {
        "graph": name,
        "key": key,
        "places": list(lines),
        "x": [_packed(line.x, "f8") for line in lines.values()],
        "y": [_packed(line.y, "f4") for line in lines.values()],
        "layout": dict(layout or {}),
    }


def _packed(values: NDArray[Any], kind: str) -> dict[str, str]:
    """An array as bytes, which the browser does not parse as text."""
    return {"dtype": kind, "bdata": base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode()}
