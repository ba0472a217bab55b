"""Measured and modelled in linked panels: over time, at the worst seconds, beside another flight or model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dash
import dash_mantine_components as dmc
import plotly.graph_objects as go
from dash import ALL, Input, Output, State, ctx, dcc, html, no_update
from plotly.subplots import make_subplots

from diagnosis.models.channels import AXES, KINDS, NAMES, UNITS
from studio.app import redraw
from studio.app.opened import OpenCase
from studio.app.parts import card, graph
from studio.app.place import result_at
from studio.app.studio import Studio
from studio.app.theme import (
    EMPTY,
    HIGHLIGHT,
    LINE_COLOURS,
    PRESENT,
    SECOND_MODEL,
    improved_colour,
    measured_colour,
    styled,
)
from studio.app.traces import (
    Line,
    channel_line,
    flight_line,
    over_floor,
    row_numbers,
    thinned,
    window_of,
    worst_windows,
    zoomed,
)
from studio.pages.flight_panels import PANELS, panel_lines, place_legends
from studio.pages.numbers import unit_shown
from studio.work.arrays import read_array
from studio.work.results import Compared, Diagnosed, Rows

AXIS_NAMES = "xyz"
HEIGHT = 720  # px
FIRST_SIGNAL = "velocity"  # below the channels, before another one is chosen
MAX_SPANS = 60  # shaded spans in a picture
NEAR = 2.0  # s on each side of a moment that was clicked
Span = tuple[float, float]


@dataclass(frozen=True, eq=False)
class DrawnLine:
    """A line of the panels. row: its panel; colour: by its name in the palette; dash: Plotly's."""

    row: int
    name: str
    colour: str
    dash: str
    line: Line


def panels(opened: OpenCase, compared: Compared, folder: Path) -> Any:
    """The linked panels, what to show in them, and the worst seconds."""
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
    signals = [p for p in PANELS if p.quantity in columns]
    signals.sort(key=lambda panel: panel.quantity != FIRST_SIGNAL)
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
                data=[{"value": p.quantity, "label": f"{p.title}, full rate"} for p in signals],
                value=signals[0].quantity if signals else None,
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
                redraw.lines_graph("compare-lines", "Lines: measurement and model over time", HEIGHT),
                html.Div(
                    graph("compare-lines-2", EMPTY, "Lines: the other flight or model", height=HEIGHT),
                    id="second-panel",
                    hidden=True,
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
        Output(redraw.points_of("compare-lines"), "data"),
        Input("compare-lines", "relayoutData"),
        State("compare-log", "value"),
        State("compare-kind", "value"),
        State("compare-signal", "value"),
        State("url", "pathname"),
        prevent_initial_call=True,
    )(lambda *arguments: _zoom(studio, *arguments))
    redraw.register(app, "compare-lines")
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


def _zoom(studio: Studio, zoom: Any, log: str, kind: str, signal: str | None, path: str) -> Any:
    """The lines again from all rows of the time that is shown."""
    there = result_at(studio, path, Compared, "compare")
    if there is None or log is None or not zoomed(zoom):
        return no_update
    opened, compared, folder = there
    lines = _lines(opened, compared.rows, folder, int(log), kind, signal, window_of(zoom))
    points = {number: drawn.line for number, drawn in enumerate(lines)}
    return redraw.redrawn("compare-lines", _key(int(log), kind, signal, lines), points)


def _draw(
    studio: Studio, log: str, kind: str, signal: str | None, window: Any, cell: Any, path: str, scheme: str
) -> tuple[Any, Any]:
    """The panels, about a window of time where one was asked for; spans of a cell are shaded."""
    there = result_at(studio, path, Compared, "compare")
    if there is None or log is None:
        return no_update, no_update
    opened, compared, folder = there
    triggered = ctx.triggered_id
    span = None
    if window is not None and (triggered in (None, "compare-window") or int(log) == window["log"]):
        log, span = str(window["log"]), (window["start"], window["stop"])
    lines = _lines(opened, compared.rows, folder, int(log), kind, signal, span)
    figure = redraw.keyed(_figure(lines, kind, signal, scheme, span), _key(int(log), kind, signal, lines))
    for shaded in (cell or {}).get("spans", [])[:MAX_SPANS]:
        if shaded[0] == int(log):
            figure.add_vrect(x0=shaded[1], x1=shaded[2], fillcolor=HIGHLIGHT, opacity=0.25, line_width=0)
    return figure, log


def _lines(
    opened: OpenCase, rows: Rows, folder: Path, log: int, kind: str, signal: str | None, span: Any
) -> list[DrawnLine]:
    """The lines of all panels: three axes with measurement and models, error over floor, a signal at its full rate."""
    place = KINDS.index(kind)
    models: list[tuple[str, str | None, str, str, Path]] = [
        ("measured", None, "measured", "solid", folder),
        ("present model", "residual", "present", "solid", folder),
    ]
    improved = opened.case.result_folder("diagnose")
    if opened.result(Diagnosed, "diagnose", shown=False) is not None and opened.is_fresh("compare"):
        models.append(("improved model", "improved", "improved", "dot", improved))
    lines: list[DrawnLine] = []
    for axis in range(AXES):
        for name, model, colour, dash_style, source in models:
            line = channel_line(source, rows, log, AXES * place + axis, model, span)
            lines.append(DrawnLine(axis, name, colour, dash_style, line))
    numbers = row_numbers(rows, log)
    time = read_array(folder, "time")[numbers]
    for name, model, colour, dash_style, source in models[1:]:
        level = over_floor(source, rows, model or "", numbers)[:, place]
        lines.append(DrawnLine(AXES, name, colour, dash_style, thinned(time, level, span)))
    flights = opened.flights()
    if flights is not None and signal is not None:
        panel = next(one for one in PANELS if one.quantity == signal)
        for one in panel_lines(panel, {c.name: c.quantity for c in flights[1][log].columns}):
            line = flight_line(flights[0], flights[1][log], log, one.column, span)
            dash = "dot" if one.is_setpoint else "solid"
            lines.append(DrawnLine(AXES + 1, one.label, f"axis{one.colour}", dash, line))
    return lines


def _figure(lines: Sequence[DrawnLine], kind: str, signal: str | None, scheme: str, span: Any) -> go.Figure:
    unit = unit_shown(UNITS[kind])
    figure = make_subplots(rows=AXES + 2, shared_xaxes=True, vertical_spacing=0.045)
    palette = {"measured": measured_colour(scheme), "present": PRESENT, "improved": improved_colour(scheme)}
    palette |= {f"axis{number}": colour for number, colour in enumerate(LINE_COLOURS)}
    palette["second"] = SECOND_MODEL
    for drawn in lines:
        trace = go.Scatter(
            x=drawn.line.x,
            y=drawn.line.y,
            name=drawn.name,
            legend=f"legend{AXES + 2}" if drawn.row == AXES + 1 else "legend",
            legendgroup=drawn.name,
            showlegend=drawn.row in (0, AXES + 1),
            mode="lines",
            line={"color": palette.get(drawn.colour, LINE_COLOURS[-1]), "width": 1.3, "dash": drawn.dash},
            hovertemplate=f"{drawn.name}: %{{y:.4g}}<extra></extra>",
        )
        figure.add_trace(trace, row=drawn.row + 1, col=1)
    for axis in range(AXES):
        figure.update_yaxes(title_text=f"{AXIS_NAMES[axis]}, {unit}", row=axis + 1, col=1)
    figure.update_yaxes(title_text="error, × floor", rangemode="tozero", row=AXES + 1, col=1)
    title = next((panel.axis_title for panel in PANELS if panel.quantity == signal), "")
    figure.update_yaxes(title_text=title, row=AXES + 2, col=1)
    figure.update_xaxes(title_text="time in the log, s", row=AXES + 2, col=1)
    styled(figure, scheme, height=HEIGHT)
    place_legends(figure, (1, AXES + 2))
    if span is not None:
        figure.update_xaxes(range=list(span))
    figure.update_layout(hovermode="x", dragmode="zoom")
    return figure


def _key(log: int, kind: str, signal: str | None, lines: Sequence[DrawnLine]) -> str:
    """Of the panels that are drawn."""
    return repr((log, kind, signal, [drawn.name for drawn in lines]))


def _draw_second(
    studio: Studio, second: str, log: str, kind: str, signal: str | None, zoom: Any, window: Any, path: str, scheme: str
) -> tuple[Any, bool]:
    """The second column: another flight, or the same flight under another version."""
    there = result_at(studio, path, Compared, "compare")
    if not second or there is None or log is None:
        return no_update, True
    opened, compared, folder = there
    span = window_of(zoom) if ctx.triggered_id == "compare-lines" else None
    if span is None and window is not None and ctx.triggered_id != "compare-lines":
        span = window["start"], window["stop"]
    what, _, number = second.partition(":")
    if what == "log":
        lines = _lines(opened, compared.rows, folder, int(number), kind, signal, None)
        return _figure(lines, kind, signal, scheme, None), False
    version = opened.case.version_number(int(number))
    other = opened.case.result_folder("compare", opened.case.key("compare", version))
    if not (other / "residual.npy").is_file():
        return no_update, True
    lines = _version_lines(other, number, compared.rows, int(log), KINDS.index(kind), span)
    return _figure(lines, kind, None, scheme, span), False


def _version_lines(folder: Path, number: str, rows: Rows, log: int, kind: int, span: Span | None) -> list[DrawnLine]:
    """Measurement, prediction and error of another version of the vehicle."""
    lines: list[DrawnLine] = []
    for axis in range(AXES):
        for name, model, colour in (("measured", None, "measured"), (f"version {number}", "residual", "second")):
            line = channel_line(folder, rows, log, AXES * kind + axis, model, span)
            lines.append(DrawnLine(axis, name, colour, "solid", line))
    numbers = row_numbers(rows, log)
    level = over_floor(folder, rows, "residual", numbers)[:, kind]
    errors = thinned(read_array(folder, "time")[numbers], level, span)
    lines.append(DrawnLine(AXES, f"version {number}", "second", "solid", errors))
    return lines


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
