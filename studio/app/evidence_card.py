"""The evidence of one effect: what it explains down to the samples, and what other values of it would do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dash
import dash_mantine_components as dmc
import numpy as np
import plotly.graph_objects as go
from dash import ALL, Input, Output, State, ctx, dcc, html, no_update
from plotly.subplots import make_subplots

from diagnosis.models.channels import AXES, KINDS, NAMES, UNITS
from diagnosis.thresholds import DEFAULT
from dynamics.errors import AlulaError
from dynamics.vehicle import EffectUse
from dynamics.vehicle_file import effect_text
from studio.app import redraw
from studio.app.opened import OpenCase
from studio.app.parts import action, card, command_box, graph, grid, message
from studio.app.place import opened_at
from studio.app.studio import Studio
from studio.app.theme import BY_HAND, KIND_COLOURS, PRESENT, figure_of, improved_colour, measured_colour, styled
from studio.app.traces import Line, channel_line, row_numbers, thinned, window_of, zoomed
from studio.pages.numbers import unit_shown
from studio.work.arrays import read_array
from studio.work.results import GRID, Diagnosed, Evidence, Rows, Slider

MARKS = 4  # steps of a slider between two values of its grid
HEIGHT = 460  # px of both pictures
MOVED = "with the effect"  # name of the lines that a slider moves
MIN_LOG_ODDS = -12.0  # log of the odds down to which a score is drawn
CURVE = 201  # points of a score's curve


@dataclass(frozen=True, eq=False)
class _DrawnLine:
    """A line of the panels."""

    axis: int
    name: str
    line: Line


def register(app: dash.Dash, studio: Studio) -> None:
    """The callbacks of the evidence."""
    app.callback(
        Output("evidence", "children"),
        Output("evidence-shown", "data"),
        Input("ranking", "selectedRows"),
        Input("revision", "data"),
        State("evidence-shown", "data"),
        State("url", "pathname"),
        State("scheme", "data"),
    )(lambda *arguments: _show(studio, *arguments))
    app.callback(
        Output("evidence-lines", "figure"),
        Output("evidence-errors", "figure"),
        Output("evidence-readout", "children"),
        Output(redraw.points_of("evidence-lines"), "data"),
        Output(redraw.points_of("evidence-errors"), "data"),
        Output("evidence-slider", "data"),
        Output("trial-command", "children"),
        Input({"slider": ALL}, "value"),
        Input("evidence-log", "value"),
        Input("evidence-kind", "value"),
        State("evidence-lines", "relayoutData"),
        State("evidence-slider", "data"),
        State("ranking", "selectedRows"),
        State("url", "pathname"),
        State("scheme", "data"),
    )(lambda *arguments: _move(studio, *arguments))
    app.callback(
        Output(redraw.points_of("evidence-lines"), "data", allow_duplicate=True),
        Input("evidence-lines", "relayoutData"),
        State({"slider": ALL}, "value"),
        State("evidence-slider", "data"),
        State("evidence-log", "value"),
        State("evidence-kind", "value"),
        State("ranking", "selectedRows"),
        State("url", "pathname"),
        prevent_initial_call=True,
    )(lambda *arguments: _zoom(studio, *arguments))
    for name in ("evidence-lines", "evidence-errors"):
        redraw.register(app, name)


def _show(studio: Studio, selected: Any, _: Any, shown: str | None, path: str, scheme: str) -> tuple[Any, Any]:
    """The evidence of the selected effect; it is computed when it is asked for the first time."""
    opened = opened_at(studio, path)
    if opened is None or not selected:
        return no_update, no_update
    key = selected[0]["key"]
    step = f"explain:{key}"
    job = opened.job.step if opened.job else ""
    there = opened.case.has_result(step)  # then the card stands, whether its job has ended or not: lines would go
    signature = repr((key, opened.case.key(step), there, not there and job == step, opened.failure))
    if signature == shown:
        return no_update, no_update
    refusal = opened.refusal(step)
    if refusal is not None:
        return card(key, message(refusal.message, title="No evidence", colour="yellow")), signature
    evidence = opened.result(Evidence, step, shown=False)
    if evidence is None:
        if job != step and ctx.triggered_id != "revision" and opened.is_fresh("diagnose"):
            try:
                opened.start("explain", effect=key)
            except AlulaError as error:
                return card(key, message(str(error), title="No evidence", colour="yellow")), signature
        return card(key, dmc.Text("What it explains is being computed.", c="dimmed")), signature
    diagnosed = opened.result(Diagnosed, "diagnose")
    if diagnosed is None:
        return no_update, no_update
    return _evidence(opened, evidence, diagnosed, scheme), signature


def _evidence(opened: OpenCase, evidence: Evidence, diagnosed: Diagnosed, scheme: str) -> Any:
    rows = diagnosed.rows
    logs = sorted({(s.log, s.flight) for s in rows.segments})
    kinds = [k for i, k in enumerate(KINDS) if any(rows.floor[AXES * i : AXES * i + AXES])]
    best_kind = max(kinds, key=lambda k: evidence.share.get(k, 0.0))
    shares = ", ".join(f"{NAMES[kind]} {100 * evidence.share[kind]:.0f} %" for kind in kinds)
    sliders = [_slider(number, slider) for number, slider in enumerate(evidence.sliders)]
    before, after = diagnosed.pictures["regimes"], evidence.pictures["regimes_after"]
    spectrum = evidence.pictures["spectrum"]
    return card(
        f"{evidence.key}, {_company(evidence)}",
        dmc.Text(
            [html.B("Fits best at "), evidence.value or "no value", f"; explains {shares} of the error above noise."]
        ),
        *_odds(evidence),
        html.Pre(evidence.formula, className="command", tabIndex=0),
        *sliders,
        dcc.Store(id="evidence-slider"),
        html.Div(id="evidence-readout", role="status", className="number"),
        command_box("", name="trial-command"),
        dmc.Group(
            [
                dmc.Select(
                    id="evidence-log",
                    label="Flight",
                    data=[{"value": str(log), "label": flight} for log, flight in logs],
                    value=str(logs[0][0]),
                    allowDeselect=False,
                    w=260,
                ),
                dmc.Select(
                    id="evidence-kind",
                    label="Channel",
                    data=[{"value": kind, "label": NAMES[kind]} for kind in kinds],
                    value=best_kind,
                    allowDeselect=False,
                    w=200,
                ),
            ]
        ),
        grid(
            redraw.lines_graph("evidence-lines", "Lines: measurement, present model, and with the effect", HEIGHT),
            redraw.lines_graph("evidence-errors", "Lines: score and error for each value of the parameter", HEIGHT),
            width=520,
        ),
        grid(
            html.Div([dmc.Text("Where it fails, before", size="sm"), _stored("evidence-map-before", before, scheme)]),
            html.Div([dmc.Text("and with this effect", size="sm"), _stored("evidence-map-after", after, scheme)]),
            _stored("evidence-spectrum", spectrum, scheme),
            width=420,
        ),
        action(
            "start",
            f"Add {evidence.key} alone",
            step="add",
            value=evidence.key,
            variant="light",
        ),
        note="Move a slider to see what another value would do; score and error follow at once. The score lets all "
        "other values follow, the lines hold them.",
    )


def _company(evidence: Evidence) -> str:
    return f"beside {' and '.join(evidence.fitted_with)}" if evidence.fitted_with else "alone"


def _odds(evidence: Evidence) -> list[Any]:
    """How much likelier the named effects are with this one than without it."""
    if evidence.score is None:
        return []
    odds, required = html.B(f"{evidence.score:.3g}"), f"; an effect is named from {DEFAULT.likelihood.named:g} on."
    return [dmc.Text(["Log of the odds that it is there against that it is not: ", odds, required])]


def _stored(name: str, picture: Any, scheme: str) -> Any:
    return graph(name, figure_of(picture, scheme), picture.description)


def _slider(number: int, slider: Slider) -> Any:
    label = f"{slider.name}, {unit_shown(slider.unit)}" if slider.unit != "1" else slider.name
    last = GRID - 1
    marks = [
        {"value": place, "label": f"{slider.values[place]:.3g}" + (" (best)" if place == slider.best else "")}
        for place in (0, slider.best, last)
    ]
    return html.Div(
        [
            dmc.Text(label, size="sm"),
            dmc.Slider(
                id={"slider": number},
                min=0,
                max=last,
                step=1 / MARKS,
                value=slider.best,
                marks=marks,
                label=None,
                updatemode="drag",
                mb="lg",
                **{"thumbLabel": label},
            ),
        ]
    )


@dataclass(frozen=True)
class _Shown:
    """The evidence that is shown: its folder, that of the diagnosis, and what they hold."""

    folder: Path
    base: Path
    evidence: Evidence
    rows: Rows


def _shown(studio: Studio, selected: Any, values: list[float], path: str) -> _Shown | None:
    """The evidence of the selected effect, None until it is there. values: of its sliders."""
    opened = opened_at(studio, path)
    if opened is None or not selected or not values:
        return None
    step = f"explain:{selected[0]['key']}"
    folder, evidence = opened.case.result_folder(step), opened.result(Evidence, step, shown=False)
    diagnosed, base = opened.result(Diagnosed, "diagnose"), opened.case.shown_result("diagnose")
    if evidence is None or diagnosed is None or base is None or len(values) != len(evidence.sliders):
        return None
    return _Shown(folder, base, evidence, diagnosed.rows)


def _move(
    studio: Studio, values: list[float], log: str, kind: str, zoom: Any, drawn: int | None, selected: Any, *place: str
) -> tuple[Any, ...]:
    """Both pictures of a flight and channel; of a slider's value the moved lines, and the mark on the curve.

    drawn: the slider whose curve is shown. place: the page's address and its scheme.
    """
    path, scheme = place
    opened, shown = opened_at(studio, path), _shown(studio, selected, values, path)
    if opened is None or shown is None:
        return (no_update,) * 7
    by_slider = isinstance(ctx.triggered_id, dict)
    moved = ctx.triggered_id["slider"] if by_slider else 0
    slider, value = shown.evidence.sliders[moved], float(values[moved])
    key, errors_key = _key(shown, log, kind), _key(shown, moved)
    # the command takes one effect: beside others it would not do the same
    same = "" if shown.evidence.fitted_with else opened.command("explain", trial=_trial(shown.evidence, values))
    errors = redraw.keyed(_errors_figure(slider, value, scheme), errors_key)
    if not by_slider:
        lines = redraw.keyed(_lines_figure(_lines(shown, int(log), kind, moved, value, None), kind, scheme), key)
        return lines, errors, _readout(slider, value), no_update, no_update, moved, same
    lines = _lines(shown, int(log), kind, moved, value, window_of(zoom))
    points = redraw.redrawn("evidence-lines", key, {n: one.line for n, one in enumerate(lines) if one.name == MOVED})
    if moved != drawn:
        return no_update, errors, _readout(slider, value), points, no_update, moved, same
    at, _ = _at(slider, value)
    mark = redraw.redrawn("evidence-errors", errors_key, {}, {"shapes[1].x0": at, "shapes[1].x1": at})
    return no_update, no_update, _readout(slider, value), points, mark, no_update, same


def _zoom(
    studio: Studio, zoom: Any, values: list[float], drawn: int | None, log: str, kind: str, selected: Any, path: str
) -> Any:
    """The lines again from all rows of the time that is shown."""
    shown = _shown(studio, selected, values, path)
    if shown is None or not zoomed(zoom):
        return no_update
    lines = _lines(shown, int(log), kind, drawn or 0, float(values[drawn or 0]), window_of(zoom))
    return redraw.redrawn("evidence-lines", _key(shown, log, kind), {n: one.line for n, one in enumerate(lines)})


def _key(shown: _Shown, *choice: Any) -> str:
    """Of a picture of the evidence."""
    return repr((shown.folder.name, choice))


def _lines(shown: _Shown, log: int, kind: str, slider: int, place: float, span: Any) -> list[_DrawnLine]:
    """Measured, present and moved model, axis by axis."""
    base, rows = shown.base, shown.rows
    numbers = row_numbers(rows, log)
    time = read_array(base, "time")[numbers]
    low = min(int(place), GRID - 2)
    grid_tables = read_array(shown.folder, f"grid_{slider}")
    lines: list[_DrawnLine] = []
    for axis in range(AXES):
        channel = AXES * KINDS.index(kind) + axis
        measured = np.asarray(read_array(base, "measured")[numbers, channel])
        near = [np.asarray(grid_tables[i][numbers, channel]) for i in (low, low + 1)]
        residual = near[0] + (place - low) * (near[1] - near[0])
        lines.append(_DrawnLine(axis, "measured", channel_line(base, rows, log, channel, None, span)))
        lines.append(_DrawnLine(axis, "present model", channel_line(base, rows, log, channel, "residual", span)))
        lines.append(_DrawnLine(axis, MOVED, thinned(time, measured - residual, span)))
    return lines


def _lines_figure(lines: list[_DrawnLine], kind: str, scheme: str) -> go.Figure:
    colours = {"measured": measured_colour(scheme), "present model": PRESENT, MOVED: improved_colour(scheme)}
    figure = make_subplots(rows=AXES, shared_xaxes=True, vertical_spacing=0.04)
    for one in lines:
        trace = go.Scatter(
            x=one.line.x,
            y=one.line.y,
            name=one.name,
            legendgroup=one.name,
            showlegend=one.axis == 0,
            mode="lines",
            line={"color": colours[one.name], "width": 1.3},
        )
        figure.add_trace(trace, row=one.axis + 1, col=1)
    for axis in range(AXES):
        figure.update_yaxes(title_text=f"{'xyz'[axis]}, {unit_shown(UNITS[kind])}", row=axis + 1, col=1)
    figure.update_xaxes(title_text="time in the log, s", row=AXES, col=1)
    styled(figure, scheme, height=HEIGHT)
    figure.update_layout(hovermode="x")
    return figure


def _at(slider: Slider, place: float) -> tuple[float, list[float | None]]:
    """Value and errors over floor at a place between two of the grid."""
    low = min(int(place), GRID - 2)
    part = place - low
    value = slider.values[low] + part * (slider.values[low + 1] - slider.values[low])
    errors = [
        None if a is None or b is None else a + part * (b - a)
        for a, b in zip(slider.rms[low], slider.rms[low + 1], strict=True)
    ]
    return value, errors


def _trial(evidence: Evidence, places: Sequence[float]) -> str:
    """The effect at the sliders' values, as `alula compare --with` takes it."""
    name, _, rotor = evidence.key.partition("[")
    values = {
        slider.name: float(f"{_at(slider, float(place))[0]:.6g}")
        for slider, place in zip(evidence.sliders, places, strict=True)
    }
    return effect_text(EffectUse(name, values, int(rotor.rstrip("]")) if rotor else None))


def _readout(slider: Slider, place: float) -> Any:
    value, errors = _at(slider, place)
    listed = ", ".join(f"{NAMES[k]} {e:.3g}" for k, e in zip(KINDS, errors, strict=True) if e is not None)
    unit = unit_shown(slider.unit) if slider.unit != "1" else ""
    score = f"log of the odds against the best value {_score(slider, value):.3g}; " if slider.std else ""
    return dmc.Text(f"{slider.name} = {value:.4g} {unit}: {score}error over floor {listed}".replace(" :", ":"))


def _score(slider: Slider, value: float) -> float:
    """Log of the odds of a value against the best one, with all others that were fitted at their best beside it."""
    return 0.0 - (((value - slider.values[slider.best]) / slider.std) ** 2) / 2


def _errors_figure(slider: Slider, place: float, scheme: str) -> go.Figure:
    """Score and error over floor against the parameter's value, the best and the chosen one and the interval marked."""
    scored = slider.std > 0
    figure = make_subplots(rows=1 + scored, shared_xaxes=True, vertical_spacing=0.05)
    for number, kind in enumerate(KINDS):
        values = [row[number] for row in slider.rms]
        if values[0] is not None:
            colour = KIND_COLOURS[kind]
            trace = go.Scatter(x=slider.values, y=values, name=NAMES[kind], line={"color": colour}, mode="lines")
            figure.add_trace(trace, row=1 + scored, col=1)
    best, over_rows = slider.values[slider.best], {"xref": "x", "yref": "paper", "y0": 0.0, "y1": 1.0}
    value, _ = _at(slider, place)
    dashed = {"dash": "dash", "color": improved_colour(scheme)}
    figure.add_shape(type="line", x0=best, x1=best, line=dashed, **over_rows)
    figure.add_shape(type="line", x0=value, x1=value, line={"color": BY_HAND, "width": 2}, **over_rows)
    figure.add_annotation(x=best, y=1, xref="x", yref="paper", text="best", showarrow=False, xanchor="left")
    unit = f", {unit_shown(slider.unit)}" if slider.unit != "1" else ""
    figure.update_xaxes(title_text=f"{slider.name}{unit}", row=1 + scored, col=1)
    figure.update_yaxes(title_text="error, × floor", rangemode="tozero", row=1 + scored, col=1)
    if scored:
        _draw_score(figure, slider, scheme)
    return styled(figure, scheme, height=HEIGHT)


def _draw_score(figure: go.Figure, slider: Slider, scheme: str) -> None:
    """The score's curve in the first row, and the 95 % interval behind all rows."""
    best, colour = slider.values[slider.best], improved_colour(scheme)
    reach = slider.std * np.sqrt(-2 * MIN_LOG_ODDS)
    low, high = max(slider.values[0], best - reach), min(slider.values[-1], best + reach)
    x = np.linspace(low, high, CURVE)
    y = [_score(slider, float(value)) for value in x]
    figure.add_trace(go.Scatter(x=x, y=y, name="score", line={"color": colour}, mode="lines"), row=1, col=1)
    figure.update_yaxes(title_text="log odds", range=[MIN_LOG_ODDS, 0.5], row=1, col=1)
    low, high = max(slider.values[0], best - 1.96 * slider.std), min(slider.values[-1], best + 1.96 * slider.std)
    band = {"xref": "x", "yref": "paper", "y0": 0.0, "y1": 1.0, "layer": "below", "line_width": 0}
    figure.add_shape(type="rect", x0=low, x1=high, fillcolor=colour, opacity=0.15, **band)
