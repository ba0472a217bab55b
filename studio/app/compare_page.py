"""Step 3: measurement and model in linked panels, where the model fails, and the seconds behind every cell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dash
import dash_mantine_components as dmc
import numpy as np
import plotly.graph_objects as go
from dash import ALL, Input, Output, Patch, State, ctx, dcc, html, no_update
from plotly.subplots import make_subplots

from diagnosis.models.channels import AXES, KINDS, NAMES, UNITS
from studio.app.opened import OpenCase
from studio.app.parts import action, card, command_box, graph, grid, message, out_of_date
from studio.app.studio import Studio
from studio.app.theme import (
    EMPTY,
    HIGHLIGHT,
    PRESENT,
    SECOND_MODEL,
    choices_of,
    figure_of,
    improved_colour,
    measured_colour,
    styled,
)
from studio.app.traces import (
    Line,
    cell_seconds,
    cells_of,
    channel_line,
    flight_line,
    over_floor,
    patched,
    row_at,
    row_numbers,
    thinned,
    window_of,
    worst_windows,
    zoomed,
)
from studio.pages.inspected import ROWS
from studio.pages.numbers import quantity_shown, unit_shown
from studio.work.arrays import read_array
from studio.work.results import Compared, Diagnosed, Rows

AXIS_NAMES = "xyz"
SHOWN_SECONDS = 8  # buttons of a cell
MAX_SPANS = 60  # shaded spans in a picture
NEAR = 2.0  # s on each side of a moment that was clicked
PATH_POINTS = 4000


def layout(opened: OpenCase, name: str, scheme: str) -> Any:
    """Panels, worst seconds, maps, path, spectra."""
    parts: list[Any] = [dmc.Title("Where does the model fail?", order=1, size="h2")]
    if opened.failure:
        parts.append(message(opened.failure, title="The last step failed", colour="red"))
    refusal = opened.refusal("compare")
    if refusal is not None:
        parts.append(message(refusal.message, title="These flights cannot answer", colour="red"))
        return dmc.Stack(parts, gap="md")
    compared, folder = opened.result(Compared, "compare"), opened.case.shown_result("compare")
    if compared is None or folder is None:
        reason = opened.lock_reason("compare")
        running = opened.job is not None
        if reason:
            parts.append(message(reason, title="Locked"))
        elif running:
            parts.append(dmc.Text("The model is evaluated along the flights.", c="dimmed"))
        else:
            parts.append(action("start", "Compare", step="compare"))
        return dmc.Stack(parts, gap="md")
    if not opened.is_fresh("compare"):
        parts.append(out_of_date("compare", running=opened.job is not None))
    comparison = compared.comparison
    parts.append(_summary(compared))
    parts.append(_panels(opened, compared, folder))
    kinds = choices_of(compared.pictures["regimes"])
    parts.append(
        card(
            "Where it fails",
            dmc.Select(id="map-kind", label="Channel", data=kinds, value=kinds[0], allowDeselect=False, w=260),
            graph("compare-map", EMPTY, "Map: error over the noise floor along each quantity"),
            html.Div(id="cell-seconds"),
            note="Click a cell to see the seconds that it is made of; click a moment above to see its cells here.",
        )
    )
    parts.append(
        card(
            "The path, coloured by error",
            graph("compare-path", _path_figure(folder, compared.rows, scheme), "Path in space, coloured by error"),
            note="Click a point to see its seconds above.",
        )
    )
    names = [key for key in ("spectrum", "agreement", "bars") if key in compared.pictures]
    titles = {
        "spectrum": "Residual spectra against the noise",
        "agreement": "Accelerometer against pose",
        "bars": "Error of each channel over its floor",
    }
    pictures = [
        card(
            titles[key],
            graph(f"compare-{key}", figure_of(compared.pictures[key], scheme), compared.pictures[key].description),
        )
        for key in names
    ]
    planes = [
        graph(f"compare-{key}", figure_of(picture, scheme), picture.description)
        for key, picture in compared.pictures.items()
        if key.startswith("plane_")
    ]
    parts.append(grid(*pictures))
    parts.append(card("Error over two quantities at once", grid(*planes, width=340)))
    if comparison.notes:
        parts.append(card("Notes", html.Ul([html.Li(note) for note in comparison.notes])))
    parts.append(dcc.Link("Next: which effect is missing?", href=f"/case/{name}/diagnose"))
    parts.append(command_box(opened.command("compare")))
    return dmc.Stack(parts, gap="md")


def _summary(compared: Compared) -> Any:
    """The worst kind of channel in a sentence, and the cells that stand out."""
    worst = max(compared.comparison.axes, key=lambda a: a.rms / a.floor)
    text = (
        f"The largest error is in {NAMES[worst.kind]} {worst.axis}: {worst.rms:.3g} {unit_shown(worst.unit)}, "
        f"{worst.rms / worst.floor:.2g} times what noise explains."
    )
    cells = [
        f"{quantity_shown(c.regime)} {c.low:.3g} to {c.high:.3g}: {NAMES[c.channel]} {c.rms_over_floor:.2g} × its floor"
        for c in compared.comparison.fails_where
    ]
    return card("In words", dmc.Text(text, fw=600), html.Ul([html.Li(cell) for cell in cells]))


def _panels(opened: OpenCase, compared: Compared, folder: Path) -> Any:
    rows = compared.rows
    logs = sorted({(s.log, s.flight) for s in rows.segments})
    kinds = [k for i, k in enumerate(KINDS) if any(rows.floor[AXES * i : AXES * i + AXES])]
    worst = worst_windows(folder, rows, "residual")
    buttons = [
        dmc.Button(
            f"{s.flight} {start:.1f} s: {level:.2g} × floor",
            id={"jump": s.log, "start": round(start, 3), "stop": round(start + 2, 3), "of": "worst"},
            size="compact-sm",
            variant="default",
            n_clicks=0,
        )
        for s, start, level in worst
    ]
    flights = opened.flights()
    columns = {c.quantity for info in (flights[1] if flights else ()) for c in info.columns}
    signals = [{"value": q, "label": f"{title}, full rate"} for q, title, _ in ROWS if q in columns]
    second = [{"value": "", "label": "nothing"}]
    second += [{"value": f"log:{log}", "label": f"flight {flight}"} for log, flight in logs]
    second += [
        {"value": f"version:{v.number}", "label": f"version {v.number}: {v.action}"}
        for v in opened.case.line
        if opened.case.result_folder("compare", opened.case.key("compare", v)).is_dir()
    ]
    controls = dmc.Group(
        [
            dmc.Select(
                id="compare-log",
                label="Flight",
                data=[{"value": str(log), "label": flight} for log, flight in logs],
                value=str(worst[0][0].log if worst else logs[0][0]),
                allowDeselect=False,
                w=260,
            ),
            dmc.Select(
                id="compare-kind",
                label="Channel",
                data=[{"value": kind, "label": NAMES[kind]} for kind in kinds],
                value=_worst_kind(compared, kinds),
                allowDeselect=False,
                w=200,
            ),
            dmc.Select(
                id="compare-signal",
                label="Below it",
                data=signals,
                value=signals[0]["value"] if signals else None,
                allowDeselect=False,
                w=220,
            ),
            dmc.Select(
                id="compare-second", label="Side by side with", data=second, value="", allowDeselect=False, w=280
            ),
        ],
        align="end",
    )
    start = worst[0][1] if worst else 0.0
    first_window = {"log": worst[0][0].log, "start": start - 1, "stop": start + 3} if worst else None
    return card(
        "Measured and modelled",
        controls,
        dmc.Group([dmc.Text("Worst seconds:", size="sm"), *buttons], gap="xs"),
        dcc.Store(id="compare-window", data=first_window),
        dcc.Store(id="compare-cell"),
        html.Div(
            [
                graph("compare-lines", EMPTY, "Lines: measurement and model over time"),
                html.Div(
                    graph("compare-lines-2", EMPTY, "Lines: the other flight or model"), id="second-panel", hidden=True
                ),
            ],
            className="grid",
            style={"--width": "560px"},
        ),
        note="Drag to zoom all panels; double-click to see the whole flight. Every zoom is drawn from all rows.",
    )


def _worst_kind(compared: Compared, kinds: list[str]) -> str:
    worst = max(compared.comparison.axes, key=lambda a: a.rms / a.floor).kind
    return worst if worst in kinds else kinds[0]


def register(app: dash.Dash, studio: Studio) -> None:
    """The callbacks of the linked panels."""
    app.callback(
        Output("compare-lines", "figure"),
        Output("compare-log", "value"),
        Input("compare-log", "value"),
        Input("compare-kind", "value"),
        Input("compare-signal", "value"),
        Input("compare-window", "data"),
        Input("compare-cell", "data"),
        State("url", "pathname"),
        State("scheme", "data"),
    )(lambda *arguments: _draw(studio, *arguments))
    app.callback(
        Output("compare-lines", "figure", allow_duplicate=True),
        Input("compare-lines", "relayoutData"),
        State("compare-log", "value"),
        State("compare-kind", "value"),
        State("compare-signal", "value"),
        State("url", "pathname"),
        prevent_initial_call=True,
    )(lambda *arguments: _zoom(studio, *arguments))
    app.callback(
        Output("compare-lines-2", "figure"),
        Output("second-panel", "hidden"),
        Input("compare-second", "value"),
        Input("compare-log", "value"),
        Input("compare-kind", "value"),
        Input("compare-signal", "value"),
        Input("compare-lines", "relayoutData"),
        Input("compare-window", "data"),
        State("url", "pathname"),
        State("scheme", "data"),
    )(lambda *arguments: _draw_second(studio, *arguments))
    app.callback(
        Output("compare-window", "data"),
        Input({"jump": ALL, "start": ALL, "stop": ALL, "of": ALL}, "n_clicks"),
        Input("compare-path", "clickData"),
        prevent_initial_call=True,
    )(_jump)
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


def _result(studio: Studio, path: str) -> tuple[OpenCase, Compared, Path] | None:
    from studio.app.shell import opened_at

    opened = opened_at(studio, path)
    if opened is None:
        return None
    compared, folder = opened.result(Compared, "compare"), opened.case.shown_result("compare")
    return None if compared is None or folder is None else (opened, compared, folder)


def _zoom(studio: Studio, zoom: Any, log: str, kind: str, signal: str | None, path: str) -> Any:
    """The lines again from all rows of the time that is shown."""
    there = _result(studio, path)
    if there is None or log is None or not zoomed(zoom):
        return no_update
    opened, compared, folder = there
    lines = _lines(opened, compared.rows, folder, int(log), kind, signal, window_of(zoom))
    return patched({number: place[-1] for number, place in enumerate(lines)})


def _draw(
    studio: Studio, log: str, kind: str, signal: str | None, window: Any, cell: Any, path: str, scheme: str
) -> tuple[Any, Any]:
    """The panels, about a window of time where one was asked for; spans of a cell are shaded."""
    there = _result(studio, path)
    if there is None or log is None:
        return no_update, no_update
    opened, compared, folder = there
    triggered = ctx.triggered_id
    span = None
    if window is not None and (triggered in (None, "compare-window") or int(log) == window["log"]):
        log, span = str(window["log"]), (window["start"], window["stop"])
    lines = _lines(opened, compared.rows, folder, int(log), kind, signal, span)
    figure = _lines_figure(lines, kind, signal, scheme, span)
    for shaded in (cell or {}).get("spans", [])[:MAX_SPANS]:
        if shaded[0] == int(log):
            figure.add_vrect(x0=shaded[1], x1=shaded[2], fillcolor=HIGHLIGHT, opacity=0.25, line_width=0)
    return figure, log


LinePlace = tuple[int, str, str, str, Line]  # row, name, colour, dash, points


def _lines(
    opened: OpenCase, rows: Rows, folder: Path, log: int, kind: str, signal: str | None, span: Any
) -> list[LinePlace]:
    """The lines of all panels: three axes with measurement and models, error over floor, a signal at its full rate."""
    place = KINDS.index(kind)
    models: list[tuple[str, str | None, str, str, Path]] = [
        ("measured", None, "measured", "solid", folder),
        ("present model", "residual", "present", "solid", folder),
    ]
    improved = opened.case.result_folder("diagnose")
    if opened.result(Diagnosed, "diagnose", shown=False) is not None and opened.is_fresh("compare"):
        models.append(("improved model", "improved", "improved", "dot", improved))
    lines: list[LinePlace] = []
    for axis in range(AXES):
        for name, model, colour, dash_style, source in models:
            line = channel_line(source, rows, log, AXES * place + axis, model, span)
            lines.append((axis, name, colour, dash_style, line))
    numbers = row_numbers(rows, log)
    time = read_array(folder, "time")[numbers]
    for name, model, colour, dash_style, source in models[1:]:
        level = over_floor(source, rows, model or "", numbers)[:, place]
        lines.append((AXES, f"error over floor, {name}", colour, dash_style, thinned(time, level, span)))
    flights = opened.flights()
    if flights is not None and signal is not None:
        columns = [c.name for c in flights[1][log].columns if c.quantity == signal]
        for number, column in enumerate(columns):
            line = flight_line(flights[0], flights[1][log], log, column, span)
            lines.append((AXES + 1, column, f"axis{number}", "solid", line))
    return lines


def _lines_figure(lines: list[LinePlace], kind: str, signal: str | None, scheme: str, span: Any) -> go.Figure:
    from studio.app.log_page import COLOURS

    unit = unit_shown(UNITS[kind])
    figure = make_subplots(rows=AXES + 2, shared_xaxes=True, vertical_spacing=0.03)
    palette = {"measured": measured_colour(scheme), "present": PRESENT, "improved": improved_colour(scheme)}
    palette |= {f"axis{number}": colour for number, colour in enumerate(COLOURS)}
    palette["second"] = SECOND_MODEL
    for row, name, colour, dash_style, line in lines:
        drawn = go.Scatter(
            x=line.x,
            y=line.y,
            name=name,
            legendgroup=name,
            showlegend=row == 0,
            mode="lines",
            line={"color": palette.get(colour, COLOURS[-1]), "width": 1.3, "dash": dash_style},
            hovertemplate=f"{name}: %{{y:.4g}}<extra></extra>",
        )
        figure.add_trace(drawn, row=row + 1, col=1)
    for axis in range(AXES):
        figure.update_yaxes(title_text=f"{AXIS_NAMES[axis]}, {unit}", row=axis + 1, col=1)
    figure.update_yaxes(title_text="error, × floor", rangemode="tozero", row=AXES + 1, col=1)
    title = next((f"{t}, {u}" if u else t for q, t, u in ROWS if q == signal), "")
    figure.update_yaxes(title_text=title, row=AXES + 2, col=1)
    figure.update_xaxes(title_text="time in the log, s", row=AXES + 2, col=1)
    styled(figure, scheme, height=720)
    if span is not None:
        figure.update_xaxes(range=list(span))
    figure.update_layout(hovermode="x", dragmode="zoom")
    return figure


def _draw_second(
    studio: Studio, second: str, log: str, kind: str, signal: str | None, zoom: Any, window: Any, path: str, scheme: str
) -> tuple[Any, bool]:
    """The second column: another flight, or the same flight under another version."""
    there = _result(studio, path)
    if not second or there is None or log is None:
        return no_update, True
    opened, compared, folder = there
    span = window_of(zoom) if ctx.triggered_id == "compare-lines" else None
    if span is None and window is not None and ctx.triggered_id != "compare-lines":
        span = window["start"], window["stop"]
    what, _, number = second.partition(":")
    if what == "log":
        lines = _lines(opened, compared.rows, folder, int(number), kind, signal, None)
        return _lines_figure(lines, kind, signal, scheme, None), False
    version = opened.case.version_number(int(number))
    other = opened.case.result_folder("compare", opened.case.key("compare", version))
    if not (other / "residual.npy").is_file():
        return no_update, True
    place = KINDS.index(kind)
    lines = []
    for axis in range(AXES):
        for name, model, colour in (("measured", None, "measured"), (f"version {number}", "residual", "second")):
            line = channel_line(other, compared.rows, int(log), AXES * place + axis, model, span)
            lines.append((axis, name, colour, "solid", line))
    numbers = row_numbers(compared.rows, int(log))
    level = over_floor(other, compared.rows, "residual", numbers)[:, place]
    lines.append(
        (
            AXES,
            f"error over floor, version {number}",
            "second",
            "solid",
            thinned(read_array(other, "time")[numbers], level, span),
        )
    )
    return _lines_figure(lines, kind, None, scheme, span), False


def _jump(clicks: list[Any], clicked: Any) -> Any:
    """The window of a button, or about a point of the path."""
    trigger = ctx.triggered_id
    if isinstance(trigger, dict):
        if not ctx.triggered[0]["value"]:
            return no_update
        return {"log": trigger["jump"], "start": trigger["start"] - 1.0, "stop": trigger["stop"] + 1.0}
    if clicked:
        log, time = clicked["points"][0]["customdata"][:2]
        return {"log": int(log), "start": time - NEAR, "stop": time + NEAR}
    return no_update


def _seconds_of_cell(studio: Studio, clicked: Any, path: str) -> tuple[Any, Any]:
    """The spans of flight in a cell, and buttons that lead to the longest."""
    there = _result(studio, path)
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
    there = _result(studio, path)
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
                "colorbar": {"title": "× floor", "thickness": 12},
            },
            customdata=np.stack([logs[::step], time[::step]], axis=1),
            hovertemplate="%{x:.2f}, %{y:.2f}, %{z:.2f} m at %{customdata[1]:.1f} s<extra></extra>",
        )
    )
    styled(figure, scheme, height=460)
    axis = {"backgroundcolor": "rgba(0,0,0,0)", "gridcolor": "#868e96", "showbackground": False}
    titles = {"xaxis": "x, m", "yaxis": "y, m", "zaxis": "z, m"}
    figure.update_layout(scene={"aspectmode": "data", **{k: {**axis, "title": t} for k, t in titles.items()}})
    return figure
