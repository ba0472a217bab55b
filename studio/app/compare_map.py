"""Where the model fails: the regime map with the seconds behind each cell, and the path coloured by error."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dash
import dash_mantine_components as dmc
import numpy as np
import plotly.graph_objects as go
from dash import Input, Output, Patch, State, ctx, html, no_update

from studio.app.parts import card, graph
from studio.app.place import result_at
from studio.app.studio import Studio
from studio.app.theme import EMPTY, HIGHLIGHT, choices_of, figure_of, styled
from studio.app.traces import cell_seconds, cells_of, over_floor, row_at
from studio.pages.flown import sides_of
from studio.pages.numbers import quantity_shown
from studio.work.arrays import read_array
from studio.work.results import Compared, Rows

SHOWN_SECONDS = 8  # buttons of a cell
PATH_POINTS = 4000
PATH_HEIGHT = 480  # px
# from where a box of sides up to 1 shows in a picture that is narrower than it is high, as on a telephone
CAMERA = {"eye": {"x": 2.1, "y": 2.1, "z": 1.6}}


def map_card(compared: Compared) -> Any:
    """The map, for a kind of channel."""
    picture = compared.pictures["regimes"]
    kinds = choices_of(picture)
    return card(
        "Where it fails",
        dmc.Select(id="map-kind", label="Channel", data=kinds, value=kinds[0], allowDeselect=False, w=260),
        graph("compare-map", EMPTY, "Map: error over the noise floor along each quantity", height=picture.height),
        html.Div(id="cell-seconds"),
        note="Click a cell to see the seconds that it is made of; click a moment above to see its cells here.",
    )


def path_card(compared: Compared, folder: Path, scheme: str) -> Any:
    """The path of all flights in space."""
    return card(
        "The path, coloured by error",
        graph("compare-path", _path_figure(folder, compared.rows, scheme), "Path in space, coloured by error"),
        note="Click a point to see its seconds above.",
    )


def register(app: dash.Dash, studio: Studio) -> None:
    """The callbacks of the map."""
    app.callback(
        Output("compare-cell", "data"),
        Output("cell-seconds", "children"),
        Input("compare-map", "clickData"),
        State("url", "pathname"),
        prevent_initial_call=True,
    )(lambda clicked, path: _seconds_of_cell(studio, clicked, path))
    app.callback(
        Output("compare-map", "figure"),
        Input("map-kind", "value"),
        Input("compare-lines", "clickData"),
        State("compare-log", "value"),
        State("url", "pathname"),
        State("scheme", "data"),
    )(lambda *arguments: _map(studio, *arguments))


def _seconds_of_cell(studio: Studio, clicked: Any, path: str) -> tuple[Any, Any]:
    """The spans of flight in a cell, and buttons that lead to the longest."""
    there = result_at(studio, path, Compared, "compare")
    if there is None or not clicked:
        return no_update, no_update
    _, compared, folder = there
    rows, point = compared.rows, clicked["points"][0]
    names = [quantity_shown(q.name) for q in rows.quantities]
    if point["y"] not in names:
        return no_update, no_update
    quantity, cell = names.index(point["y"]), int(point["x"]) - 1
    spans = cell_seconds(folder, rows, quantity, cell)
    flights = {s.log: s.flight for s in rows.segments}
    edges = rows.quantities[quantity].edges
    label = f"{names[quantity]} from {edges[cell]:.3g} to {edges[cell + 1]:.3g}"
    buttons = [
        dmc.Button(
            f"{flights[log]} {start:.1f} to {stop:.1f} s",
            id={"jump": log, "start": round(start, 3), "stop": round(stop, 3), "of": "cell"},
            size="compact-sm",
            variant="default",
            n_clicks=0,
        )
        for log, start, stop in spans[:SHOWN_SECONDS]
    ]
    total = sum(stop - start for _, start, stop in spans)
    text = dmc.Text(f"{label}: {total:.1f} s in {len(spans)} spans, shaded above. The longest:", size="sm")
    return {"spans": spans, "label": label}, dmc.Group([text, *buttons], gap="xs")


def _map(studio: Studio, kind: str, clicked: Any, log: str, path: str, scheme: str) -> Any:
    """The regime map of a kind of channel, with a frame about the cells of a moment that was clicked."""
    there = result_at(studio, path, Compared, "compare")
    if there is None:
        return no_update
    _, compared, folder = there
    if ctx.triggered_id == "compare-lines":
        row = row_at(folder, compared.rows, int(log), clicked["points"][0]["x"]) if clicked else None
        if row is None:
            return no_update
        patch = Patch()
        cells = [int(cells_of(folder, compared.rows, q)[row]) for q in range(len(compared.rows.quantities))]
        patch["layout"]["shapes"] = [
            {
                "type": "rect",
                "x0": cell - 0.48,
                "x1": cell + 0.48,
                "y0": quantity - 0.48,
                "y1": quantity + 0.48,
                "line": {"color": HIGHLIGHT, "width": 3},
            }
            for quantity, cell in enumerate(cells)
            if cell >= 0
        ]
        return patch
    return figure_of(compared.pictures["regimes"], scheme, choice=kind)


def _path_figure(folder: Path, rows: Rows, scheme: str) -> go.Figure:
    """The path of all flights, coloured by the error over floor of all channels."""
    level = np.sqrt(np.nanmean(over_floor(folder, rows, "residual") ** 2, axis=1))
    position, time = read_array(folder, "position"), read_array(folder, "time")
    logs = np.zeros(len(time))
    for segment in rows.segments:
        logs[segment.first : segment.stop] = segment.log
    step = max(1, len(time) // PATH_POINTS)
    figure = go.Figure(
        go.Scatter3d(
            x=position[::step, 0],
            y=position[::step, 1],
            z=position[::step, 2],
            mode="markers",
            marker={
                "size": 3,
                "color": level[::step],
                "colorscale": "Cividis",
                "cmin": 1.0,
                "cmax": max(2.0, float(np.nanquantile(level, 0.99))),
                "colorbar": {"title": "× floor", "thickness": 12, "orientation": "h", "y": 0, "yanchor": "top"},
            },
            customdata=np.stack([logs[::step], time[::step]], axis=1),
            hovertemplate="%{x:.2f}, %{y:.2f}, %{z:.2f} m at %{customdata[1]:.1f} s<extra></extra>",
        )
    )
    styled(figure, scheme, height=PATH_HEIGHT)
    axis = {"backgroundcolor": "rgba(0,0,0,0)", "gridcolor": "#868e96", "showbackground": False}
    titles = {"xaxis": "x, m", "yaxis": "y, m", "zaxis": "z, m"}
    sides = dict(zip("xyz", sides_of(position[np.isfinite(position).all(axis=1)]).tolist(), strict=True))
    axes = {k: {**axis, "title": t} for k, t in titles.items()}
    scene = {"aspectmode": "manual", "aspectratio": sides, "camera": CAMERA, **axes}
    figure.update_layout(scene=scene, margin={"l": 0, "r": 0, "t": 0, "b": 64})
    return figure
