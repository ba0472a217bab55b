"""Step 4: the verdict, the ranking with its evidence down to the samples, and effects switched on by hand."""

from __future__ import annotations

from collections.abc import Collection
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
from diagnosis.report import refusal_sentence
from dynamics.errors import AlulaError
from studio.app.opened import OpenCase
from studio.app.parts import action, badge, card, command_box, graph, grid, message, out_of_date, table
from studio.app.studio import Studio
from studio.app.theme import BY_HAND, EMPTY, PRESENT, figure_of, improved_colour, measured_colour, styled
from studio.app.traces import Line, channel_line, patched, row_numbers, thinned, window_of, zoomed
from studio.pages.figure import GREEN, PURPLE, SKY
from studio.pages.numbers import unit_shown
from studio.work.arrays import read_array
from studio.work.evidence import GRID
from studio.work.results import Diagnosed, Evidence, Rows, Slider

KIND_COLOURS = dict(zip(KINDS, (PRESENT, SKY, GREEN, PURPLE), strict=True))
MARKS = 4  # steps of a slider between two values of its grid


def layout(opened: OpenCase, name: str, scheme: str) -> Any:
    """Verdict, ranking, evidence of one effect."""
    parts: list[Any] = [dmc.Title("Which effect is missing?", order=1, size="h2")]
    if opened.failure:
        parts.append(message(opened.failure, title="The last step failed", colour="red"))
    refusal = opened.refusal("diagnose")
    if refusal is not None:
        parts.append(message(refusal.message, title="These flights cannot answer", colour="red"))
        return dmc.Stack(parts, gap="md")
    diagnosed = opened.result(Diagnosed, "diagnose")
    running = opened.job is not None and opened.job.step == "diagnose"
    reason = opened.lock_reason("diagnose")
    if diagnosed is None:
        if reason:
            parts.append(message(reason, title="Locked"))
        elif not running:
            text = "All effects of the catalogue compete over the flights; held-out flights decide."
            parts += [dmc.Text(text), action("start", "Diagnose", step="diagnose")]
        parts.append(command_box(opened.command("diagnose")))
        return dmc.Stack(parts, gap="md")
    if not opened.is_fresh("diagnose"):
        parts.append(out_of_date("diagnose", running=running))
    parts += [
        _verdict(diagnosed, name),
        card("Error of each channel, held out", _picture(diagnosed, "bars", scheme)),
        _ranking(diagnosed),
        html.Div(id="evidence"),
        dcc.Store(id="evidence-shown"),
        grid(
            card("Residual spectra against the noise", _picture(diagnosed, "spectrum", scheme)),
            card(
                "Who cannot be told from whom",
                _picture(diagnosed, "likeness", scheme),
                note="Share of its signal that each effect has in common with each other on these flights.",
            ),
        ),
        command_box(opened.command("diagnose")),
    ]
    return dmc.Stack(parts, gap="md")


def _picture(diagnosed: Diagnosed, key: str, scheme: str) -> Any:
    picture = diagnosed.pictures[key]
    return graph(f"diagnose-{key}", figure_of(picture, scheme), picture.description)


def _verdict(diagnosed: Diagnosed, name: str) -> Any:
    """The sentence first, then what is left and what to do."""
    diagnosis = diagnosed.diagnosis
    parts: list[Any] = [
        dmc.Group([badge(diagnosis.verdict), dmc.Text(diagnosed.sentence, fw=600, size="lg", id="verdict-sentence")])
    ]
    if diagnosed.leftovers:
        parts += [dmc.Text("What is left:"), html.Ul([html.Li(line) for line in diagnosed.leftovers])]
    hints = [refusal_sentence(r, diagnosis.rotors) for r in diagnosis.refused if r.is_hint]
    if hints:
        parts += [dmc.Text("Hints, for which these flights are too few:"), html.Ul([html.Li(h) for h in hints])]
    if diagnosis.not_excited:
        text = f"Not excited, so neither present nor absent: {', '.join(diagnosis.not_excited)}."
        parts.append(dmc.Text(text, size="sm", c="dimmed"))
    parts += [html.Ul([html.Li(note) for note in diagnosed.notes])] if diagnosed.notes else []
    if diagnosis.next_flight:
        parts.append(dmc.Text([html.B("Next flight: "), diagnosis.next_flight]))
    if diagnosed.addable:
        parts.append(dcc.Link("Next: add it and watch the error fall", href=f"/case/{name}/add"))
    return card("The verdict", *parts)


def _ranking(diagnosed: Diagnosed) -> Any:
    rows = [
        {
            "effect": one.key + (" (yours)" if one.own else ""),
            "key": one.key,
            "outcome": one.outcome.replace("_", " "),
            "score": one.score,
            "value": one.value,
            "reason": one.reason,
            "summary": one.summary,
        }
        for one in diagnosed.ranking
    ]
    columns = [
        {"field": "effect", "headerName": "effect", "pinned": "left", "width": 190},
        {"field": "outcome", "headerName": "outcome", "width": 120},
        {
            "field": "score",
            "headerName": "score alone",
            "width": 120,
            "type": "numericColumn",
            "valueFormatter": {"function": "params.value == null ? '' : d3.format(',.4~g')(params.value)"},
        },
        {"field": "value", "headerName": "value", "flex": 2},
        {"field": "reason", "headerName": "why not", "flex": 3},
        {"field": "summary", "headerName": "what it is", "flex": 2},
    ]
    return card(
        "Ranking",
        table(
            "ranking",
            rows,
            columns,
            height=420,
            options={"rowSelection": {"mode": "singleRow", "checkboxes": False, "enableClickSelection": True}},
            selectedRows=rows[:1],
            getRowId="params.data.key",
        ),
        note="Select an effect to see what it explains, and to try other values of it by hand.",
    )


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
        Output("evidence-readout", "children"),
        Output("evidence-errors", "figure"),
        Input({"slider": ALL}, "value"),
        Input("evidence-log", "value"),
        Input("evidence-kind", "value"),
        State("evidence-lines", "relayoutData"),
        State("ranking", "selectedRows"),
        State("url", "pathname"),
        State("scheme", "data"),
    )(lambda *arguments: _move(studio, *arguments))
    app.callback(
        Output("evidence-lines", "figure", allow_duplicate=True),
        Input("evidence-lines", "relayoutData"),
        State({"slider": ALL}, "value"),
        State("evidence-log", "value"),
        State("evidence-kind", "value"),
        State("ranking", "selectedRows"),
        State("url", "pathname"),
        prevent_initial_call=True,
    )(lambda *arguments: _zoom(studio, *arguments))


def _opened(studio: Studio, path: str) -> OpenCase | None:
    from studio.app.shell import opened_at

    return opened_at(studio, path)


def _show(studio: Studio, selected: Any, _: Any, shown: str | None, path: str, scheme: str) -> tuple[Any, Any]:
    """The evidence of the selected effect; it is computed when it is asked for the first time."""
    opened = _opened(studio, path)
    if opened is None or not selected:
        return no_update, no_update
    key = selected[0]["key"]
    step = f"explain:{key}"
    job = opened.job.step if opened.job else ""
    signature = repr((key, opened.case.key(step), opened.case.has_result(step), job == step, opened.failure))
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
        f"{evidence.key}, alone",
        dmc.Text(
            [html.B("Fits best at "), evidence.value or "no value", f"; explains {shares} of the error above noise."]
        ),
        html.Pre(evidence.formula, className="command", tabIndex=0),
        *sliders,
        html.Div(id="evidence-readout", role="status", className="number"),
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
            graph("evidence-lines", EMPTY, "Lines: measurement, present model, and with the effect"),
            graph("evidence-errors", EMPTY, "Lines: error over floor for each value of the parameter"),
            width=520,
        ),
        grid(
            html.Div([dmc.Text("Where it fails, before", size="sm"), _stored("evidence-map-before", before, scheme)]),
            html.Div([dmc.Text("and with this effect", size="sm"), _stored("evidence-map-after", after, scheme)]),
            _stored("evidence-spectrum", spectrum, scheme),
            width=420,
        ),
        action("start", f"Add {evidence.key} alone", step="add", value=evidence.key, variant="light"),
        note="Move a slider to see what another value would do; the error follows at once.",
    )


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
    opened = _opened(studio, path)
    if opened is None or not selected or not values:
        return None
    step = f"explain:{selected[0]['key']}"
    folder, evidence = opened.case.result_folder(step), opened.result(Evidence, step, shown=False)
    diagnosed, base = opened.result(Diagnosed, "diagnose"), opened.case.shown_result("diagnose")
    if evidence is None or diagnosed is None or base is None or len(values) != len(evidence.sliders):
        return None
    return _Shown(folder, base, evidence, diagnosed.rows)


def _move(
    studio: Studio, values: list[float], log: str, kind: str, zoom: Any, selected: Any, path: str, scheme: str
) -> tuple[Any, Any, Any]:
    """Redraw for a slider's value: lines of the moved model, the errors in words, and the mark on their curve."""
    shown = _shown(studio, selected, values, path)
    if shown is None:
        return no_update, no_update, no_update
    by_slider = isinstance(ctx.triggered_id, dict)
    moved = ctx.triggered_id["slider"] if by_slider else 0
    slider, place = shown.evidence.sliders[moved], float(values[moved])
    span = window_of(zoom) if by_slider else None
    lines = _lines(shown, int(log), kind, moved, place, span)
    drawn = _patched(lines, {"with the effect"}) if by_slider else _lines_figure(lines, kind, scheme)
    return drawn, _readout(slider, place), _errors_figure(slider, place, scheme)


def _zoom(studio: Studio, zoom: Any, values: list[float], log: str, kind: str, selected: Any, path: str) -> Any:
    """The lines again from all rows of the time that is shown."""
    shown = _shown(studio, selected, values, path)
    if shown is None or not zoomed(zoom):
        return no_update
    lines = _lines(shown, int(log), kind, 0, float(values[0]), window_of(zoom))
    return _patched(lines, {name for _, name, _ in lines})


def _lines(shown: _Shown, log: int, kind: str, slider: int, place: float, span: Any) -> list[tuple[int, str, Line]]:
    """Measured, present and moved model, axis by axis."""
    base, rows = shown.base, shown.rows
    numbers = row_numbers(rows, log)
    time = read_array(base, "time")[numbers]
    low = min(int(place), GRID - 2)
    grid_tables = read_array(shown.folder, f"grid_{slider}")
    lines: list[tuple[int, str, Line]] = []
    for axis in range(AXES):
        channel = AXES * KINDS.index(kind) + axis
        measured = np.asarray(read_array(base, "measured")[numbers, channel])
        near = [np.asarray(grid_tables[i][numbers, channel]) for i in (low, low + 1)]
        residual = near[0] + (place - low) * (near[1] - near[0])
        lines.append((axis, "measured", channel_line(base, rows, log, channel, None, span)))
        lines.append((axis, "present model", channel_line(base, rows, log, channel, "residual", span)))
        lines.append((axis, "with the effect", thinned(time, measured - residual, span)))
    return lines


def _lines_figure(lines: list[tuple[int, str, Line]], kind: str, scheme: str) -> go.Figure:
    colours = {
        "measured": measured_colour(scheme),
        "present model": PRESENT,
        "with the effect": improved_colour(scheme),
    }
    figure = make_subplots(rows=AXES, shared_xaxes=True, vertical_spacing=0.04)
    for axis, name, line in lines:
        drawn = go.Scatter(
            x=line.x,
            y=line.y,
            name=name,
            legendgroup=name,
            showlegend=axis == 0,
            mode="lines",
            line={"color": colours[name], "width": 1.3},
        )
        figure.add_trace(drawn, row=axis + 1, col=1)
        figure.update_yaxes(title_text=f"{'xyz'[axis]}, {unit_shown(UNITS[kind])}", row=axis + 1, col=1)
    figure.update_xaxes(title_text="time in the log, s", row=AXES, col=1)
    styled(figure, scheme, height=460)
    figure.update_layout(hovermode="x")
    return figure


def _patched(lines: list[tuple[int, str, Line]], names: Collection[str]) -> Any:
    """New points for the lines of these names."""
    return patched({number: line for number, (_, name, line) in enumerate(lines) if name in names})


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


def _readout(slider: Slider, place: float) -> Any:
    value, errors = _at(slider, place)
    listed = ", ".join(f"{NAMES[k]} {e:.3g}" for k, e in zip(KINDS, errors, strict=True) if e is not None)
    return dmc.Text(
        f"{slider.name} = {value:.4g} {unit_shown(slider.unit)}: error over floor {listed}".replace("  ", " ")
    )


def _errors_figure(slider: Slider, place: float, scheme: str) -> go.Figure:
    """Error over floor against the parameter's value, the best one and the chosen one marked."""
    figure = go.Figure()
    for number, kind in enumerate(KINDS):
        values = [row[number] for row in slider.rms]
        if values[0] is not None:
            colour = KIND_COLOURS[kind]
            figure.add_trace(
                go.Scatter(x=slider.values, y=values, name=NAMES[kind], line={"color": colour}, mode="lines")
            )
    best = slider.values[slider.best]
    figure.add_vline(x=best, line={"dash": "dash", "color": improved_colour(scheme)}, annotation_text="best")
    value, _ = _at(slider, place)
    figure.add_vline(x=value, line={"color": BY_HAND, "width": 2})
    unit = f", {unit_shown(slider.unit)}" if slider.unit != "1" else ""
    figure.update_xaxes(title_text=f"{slider.name}{unit}")
    figure.update_yaxes(title_text="error, × floor", rangemode="tozero")
    return styled(figure, scheme, height=460)
