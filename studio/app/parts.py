"""Pieces that the pages of the studio share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import dash_ag_grid as dag
import dash_mantine_components as dmc
from dash import dcc, html

from studio.app.theme import CONFIG

SAVED_AS = ("png", "svg", "pdf")
VERDICT_COLOURS = {
    "explained": "teal",
    "effect": "blue",
    "ambiguous": "yellow",
    "unknown": "orange",
    "good": "teal",
    "limited": "yellow",
    "unusable": "red",
}


def action(name: str, label: str, *, disabled: bool = False, variant: str = "filled", **arguments: str) -> Any:
    """A button that does something to the case: one callback serves them all."""
    place = {"act": name, "step": "", "value": "", **arguments}
    return dmc.Button(label, id=place, disabled=disabled, variant=variant, n_clicks=0)


def graph(name: str, figure: Any, description: str, *, height: int | None = None) -> Any:
    """A picture with its description for screen readers, and buttons that save it as it is seen.

    height: px, by default the figure's own; of a picture that is drawn later.
    """
    drawn = dcc.Graph(id=name, figure=figure, config=CONFIG, style=sized(height or figure["layout"]["height"]))
    formats = [html.Button(kind.upper(), type="button", **{"data-format": kind}) for kind in SAVED_AS]
    save = html.Div(["Save as ", *formats, html.Span("", className="answer", role="status")], className="save")
    return html.Div([drawn, save], role="group", className="picture", **{"aria-label": description})


def sized(height: int) -> dict[str, str]:
    """The style of a picture's element, px: Plotly forgets a figure's own height when the window's width changes."""
    return {"height": f"{height}px"}


def card(title: str, *children: Any, note: str = "") -> Any:
    """A part of a page under a heading."""
    head: list[Any] = [dmc.Title(title, order=2, size="h4")]
    if note:
        head.append(dmc.Text(note, size="sm", c="dimmed"))
    return dmc.Card([dmc.Stack([*head, *children], gap="xs")], withBorder=True, radius="md", padding="md")


def command_box(command: str, *, name: str = "command", label: str = "The same as a command:") -> Any:
    """The command line that does the same, or what its label says, with a button that copies it."""
    box = html.Pre(command, id=name, tabIndex=0, className="command")
    copy = dcc.Clipboard(target_id=name, title="copy the command", className="copy")
    return html.Div([dmc.Text(label, size="sm", c="dimmed"), html.Div([box, copy], className="row")])


def message(text: str, *, title: str, colour: str = "blue") -> Any:
    """A sentence that a user must not miss, and that a screen reader says at once: the component is an alert."""
    return dmc.Alert(text, title=title, color=colour, variant="light")


def out_of_date(step: str, *, running: bool) -> Any:
    """The banner above a result that was made before something changed."""
    text = "Something above has changed since this was made."
    button = [] if running else [action("start", "Bring it up to date", step=step, value="again", variant="light")]
    return dmc.Alert(dmc.Group([dmc.Text(text), *button]), title="Out of date", color="yellow", variant="light")


def table(
    name: str,
    rows: Sequence[dict[str, Any]],
    columns: Sequence[dict[str, Any]],
    *,
    height: int | None = None,
    **more: Any,
) -> Any:
    """A table that can be sorted; the text of a cell wraps, so that nothing is cut.

    height: px, after which it scrolls.
    """
    default = {"sortable": True, "resizable": True, "wrapText": True, "autoHeight": True, "minWidth": 90}
    layout = "autoHeight" if height is None else "normal"
    options = {"domLayout": layout, "animateRows": False, **more.pop("options", {})}
    return dag.AgGrid(
        id=name,
        rowData=list(rows),
        columnDefs=list(columns),
        defaultColDef=default,
        dashGridOptions=options,
        columnSize="responsiveSizeToFit",
        className="ag-theme-quartz",
        style={"height": height, "width": "100%"},
        **more,
    )


def badge(text: str) -> Any:
    """A verdict."""
    return dmc.Badge(text, color=VERDICT_COLOURS.get(text, "gray"), size="lg", variant="light")


def grid(*children: Any, width: int = 420) -> Any:
    """Parts side by side, as many as the screen is wide."""
    return html.Div(children, className="grid", style={"--width": f"{width}px"})
