"""Step 5: effects into the vehicle file, the error that falls, undo and redo, and the history of versions."""

from __future__ import annotations

from typing import Any

import dash_mantine_components as dmc
import plotly.graph_objects as go
from dash import dcc, html

from diagnosis.models.channels import KINDS, NAMES
from diagnosis.report import ParameterValue
from studio.app.heads import head, lock, refusal
from studio.app.opened import OpenCase
from studio.app.parts import action, card, command_box, graph, grid, table
from studio.app.theme import KIND_COLOURS, PRESENT, improved_colour, styled
from studio.case.state import Version
from studio.pages.figure import FLOOR
from studio.pages.numbers import unit_shown
from studio.work.results import Added, Diagnosed


def layout(opened: OpenCase, name: str, scheme: str) -> Any:
    """Effects that can be added, those that were, and by how much the error fell."""
    case, parts = opened.case, head(opened, "Add it, and watch the error fall")
    if locked := lock(opened, "add"):
        return dmc.Stack(parts + locked, gap="md")
    parts += refusal(opened, "add", "Nothing was added")
    parts.append(_offer(opened, name))
    line = [version for version in case.line if version.channels]
    if line:
        parts.append(
            card(
                "Error on held-out flights, version by version",
                grid(
                    graph("falls", _falls_figure(opened, scheme), "Lines: error over floor of each channel by version"),
                    graph(
                        "last-addition",
                        _bars_figure(line[-1], scheme),
                        "Bars: error before and after the last addition",
                    ),
                    width=460,
                ),
            )
        )
        parts.append(_parameters(opened))
    parts.append(_history(opened, name))
    parts.append(command_box(opened.command("add")))
    return dmc.Stack(parts, gap="md")


def _offer(opened: OpenCase, name: str) -> Any:
    """The effects that the diagnosis names, and the buttons."""
    running = opened.job is not None
    diagnosed, fresh = opened.result(Diagnosed, "diagnose"), opened.is_fresh("diagnose")
    state = opened.case.state
    if diagnosed is None or not fresh:
        offer = [
            dmc.Text("The present version is not diagnosed yet: is anything else missing?"),
            action("start", "Diagnose the present version", step="diagnose", disabled=running),
        ]
    elif not diagnosed.addable:
        offer = [dmc.Text(diagnosed.sentence, fw=600), dmc.Text("Nothing more can be added from these flights.")]
    else:
        names = ", ".join(diagnosed.addable)
        offer = [
            dmc.Text(diagnosed.sentence, fw=600),
            action("start", f"Add {names}", step="add", disabled=running),
        ]
    undo = action("undo", "Undo", variant="default", disabled=running or not _can_undo(opened))
    redo = action("redo", "Redo", variant="default", disabled=running or not state.undone)
    version = opened.case.version
    save = []
    if version is not None:
        file = f"/case/{name}/vehicle/{version.number}.toml"
        save = [html.A("Save the vehicle file", href=file, download=True, id="save-vehicle")]
    links = [dcc.Link("Next: prove it", href=f"/case/{name}/prove")] if version and version.parent else []
    return card("What to add", *offer, dmc.Group([undo, redo, *save, *links]))


def _can_undo(opened: OpenCase) -> bool:
    version = opened.case.version
    return version is not None and bool(version.parent)


def _falls_figure(opened: OpenCase, scheme: str) -> go.Figure:
    """Error over floor of each kind of channel in every version, those that were undone open."""
    case, figure = opened.case, go.Figure()
    line = [v for v in case.line if v.channels]
    current = case.version.number if case.version else 0
    kinds = [kind for kind in KINDS if kind in line[0].channels]
    labels = ["before", *(f"v{v.number}: {v.action}" for v in line)]
    for kind in kinds:
        first = line[0].channels[kind]
        values = [first.before / first.floor]
        values += [v.channels[kind].after / v.channels[kind].floor for v in line if kind in v.channels]
        symbols = ["circle", *("circle" if v.number <= current else "circle-open" for v in line)]
        figure.add_trace(
            go.Scatter(
                x=labels,
                y=values,
                name=NAMES[kind],
                mode="lines+markers",
                line={"color": KIND_COLOURS[kind], "width": 2},
                marker={"symbol": symbols, "size": 10},
                hovertemplate=f"{NAMES[kind]}: %{{y:.3g}} × floor<extra></extra>",
            )
        )
    figure.add_hline(y=1, line={"color": FLOOR, "dash": "dash"})
    figure.update_yaxes(title_text="RMS, × noise floor", rangemode="tozero")
    figure.update_xaxes(type="category", automargin=True)
    return styled(figure, scheme, height=380)


def _bars_figure(version: Version, scheme: str) -> go.Figure:
    """Before and after the last addition, by kind of channel."""
    figure = go.Figure()
    kinds = [kind for kind in KINDS if kind in version.channels]
    names = [NAMES[kind] for kind in kinds]
    levels = [version.channels[kind] for kind in kinds]
    for label, colour, values in (
        ("before", PRESENT, [level.before for level in levels]),
        ("after", improved_colour(scheme), [level.after for level in levels]),
    ):
        over = [value / level.floor for value, level in zip(values, levels, strict=True)]
        texts = [f"{value:.3g} {unit_shown(level.unit)}" for value, level in zip(values, levels, strict=True)]
        figure.add_trace(go.Bar(y=names, x=over, name=label, orientation="h", marker_color=colour, text=texts))
    figure.add_vline(x=1, line={"color": FLOOR, "dash": "dash"})
    figure.update_layout(barmode="group")
    figure.update_yaxes(autorange="reversed")
    figure.update_xaxes(title_text=f"× noise floor, version {version.number}")
    return styled(figure, scheme, height=380)


def _parameters(opened: OpenCase) -> Any:
    """The fitted values of the last addition that is current, and its notes."""
    added = opened.result(Added, "add")
    if added is None:
        return None
    items = [
        html.Li(f"{key} {name} = {_interval(estimate)}")
        for key, values in added.report.parameters.items()
        for name, estimate in values.items()
    ]
    notes = [html.Li(note) for note in added.report.notes]
    return card("Values of the last addition", html.Ul(items), html.Ul(notes) if notes else None)


def _interval(estimate: ParameterValue) -> str:
    """A value with its 95 % interval."""
    spread = f" ± {1.96 * estimate.std:.2g}" if estimate.std else ""
    return f"{estimate.value:.4g}{spread} {unit_shown(estimate.unit)}".rstrip()


def _history(opened: OpenCase, name: str) -> Any:
    state = opened.case.state
    line = {version.number for version in opened.case.line}
    rows = [
        {
            "version": version.number,
            "what": version.action + ("" if version.number in line else " (another branch)"),
            "who": version.author,
            "when": version.date.replace("T", " ").partition("+")[0],
            "state": "current"
            if version.number == state.current
            else ("undone" if version.number in state.undone else ""),
            "command": version.command,
            "file": f"[save](/case/{name}/vehicle/{version.number}.toml)",
        }
        for version in reversed(state.versions)
    ]
    columns = [
        {"field": "version", "headerName": "version", "width": 90},
        {"field": "what", "headerName": "what was done", "flex": 2},
        {"field": "who", "headerName": "by", "width": 110},
        {"field": "when", "headerName": "when, UTC", "width": 170},
        {"field": "state", "headerName": "", "width": 100},
        {"field": "command", "headerName": "the same as a command", "flex": 3},
        {"field": "file", "headerName": "file", "cellRenderer": "markdown", "width": 80},
    ]
    return card("Versions", table("history", rows, columns))
