"""A result that lies on disk: a fleet, a sweep, a training, an evaluation, a flight; redrawn when it changes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import dash
import dash_mantine_components as dmc
from dash import MATCH, ClientsideFunction, Input, Output, State, dcc, html

from dynamics.errors import AlulaError
from studio.app.parts import action, card, command_box, graph, message, table
from studio.app.studio import Studio
from studio.app.theme import choices_of, figure_of
from studio.pages.figure import Picture
from studio.pages.numbers import shown as number_shown
from studio.pages.shown import Shown
from studio.pages.tables import Image, PageTable

LONG = 12  # rows, from which a table scrolls
HEIGHT = 460  # px of one that does
PLOT_ID = "result-{}"


def layout(studio: Studio, path: Path, scheme: str) -> Any:
    """The answer in words, progress, pictures, tables."""
    try:
        shown = studio.reader.show(path)
    except AlulaError as error:
        return message(str(error), title="This cannot be shown", colour="red")
    parts: list[Any] = [
        dmc.Title(shown.title, order=1, size="h2"),
        dmc.Text(str(path), size="sm", c="dimmed"),
        *_progress(shown),
        card("In words", *(dmc.Text(line, fw=600 if first else 400) for first, line in _first(shown.lines))),
    ]
    parts += [card(title, *_picture(number, one, scheme)) for number, (title, one) in enumerate(shown.pictures.items())]
    parts += [_image(image) for image in shown.images]
    parts += [_table(number, one) for number, one in enumerate(shown.tables)]
    if shown.replayable:
        parts.append(_replay(studio, path))
    if shown.logs:
        parts.append(_open_as_case(shown))
    if shown.command:
        parts.append(command_box(shown.command))
    return dmc.Stack(parts, gap="md")


def signature(studio: Studio, path: Path) -> str:
    """Signature of the page; it is redrawn when this changes."""
    try:
        return repr((studio.reader.stamp(path), studio.replays.lines(path)))
    except AlulaError as error:
        return str(error)


def register(app: dash.Dash) -> None:
    """The menus of pictures, in the browser."""
    app.clientside_callback(
        ClientsideFunction("studio", "choose"),
        Output({"chosen": MATCH}, "data"),
        Input({"choice": MATCH}, "value"),
        State({"choice": MATCH}, "id"),
    )


def _first(lines: Sequence[str]) -> list[tuple[bool, str]]:
    return [(number == 0, line) for number, line in enumerate(lines)]


def _progress(shown: Shown) -> list[Any]:
    if shown.share is None:
        return []
    text = f"{100 * shown.share:.0f} % done; the page follows."
    bar = dmc.Progress(value=100 * shown.share, size="md", **{"aria-label": text})
    return [dmc.Paper(dmc.Stack([dmc.Text(text, size="sm", id="result-share"), bar], gap=4), withBorder=True, p="xs")]


def _picture(number: int, picture: Picture, scheme: str) -> list[Any]:
    """A picture, with its menu where it has one."""
    name, choices = PLOT_ID.format(number), choices_of(picture)
    drawn = [graph(name, figure_of(picture, scheme), picture.description)]
    if not choices:
        return drawn
    menu = dmc.Select(
        id={"choice": name}, label="Shown", data=choices, value=choices[0], allowDeselect=False, searchable=True, w=420
    )
    return [menu, dcc.Store(id={"chosen": name}), *drawn]


def _image(image: Image) -> Any:
    source = f"data:image/png;base64,{image.base64}"
    return card(image.description, html.Img(src=source, alt=image.description, className="picture"))


def _table(number: int, shown: PageTable) -> Any:
    """A table whose numbers have as many digits as people want, and sort as numbers."""
    digits = shown.digits
    rows = [{f"c{i}": _cell(cell) for i, cell in enumerate(row)} for row in shown.rows]
    columns = []
    for place, heading in enumerate(shown.headings):
        cells = [row[place] for row in shown.rows if row[place] is not None]
        column: dict[str, Any] = {"field": f"c{place}", "headerName": heading or " ", "filter": True}
        if cells and not any(isinstance(cell, str) for cell in cells):
            integers = all(isinstance(cell, int) for cell in cells)
            number_format = "d3.format(',')" if integers else f"d3.format('.{digits}~g')"
            function = f"params.value == null ? '' : {number_format}(params.value)"
            column |= {"type": "numericColumn", "valueFormatter": {"function": function}}
        else:
            longest = max((len(str(cell)) for cell in cells), default=1)
            column["flex"] = min(4, 1 + longest // 20)
        columns.append(column)
    height = HEIGHT if len(rows) > LONG else None
    return card(shown.title, table(f"result-table-{number}", rows, columns, height=height), note=shown.note)


def _cell(cell: Any) -> Any:
    """A cell as JSON has it; what is not finite is written."""
    if isinstance(cell, float) and not abs(cell) < float("inf"):
        return None if cell != cell else number_shown(cell)
    return cell


def _replay(studio: Studio, path: Path) -> Any:
    lines = studio.replays.lines(path)
    again = action("replay", "Fly it again", value=str(path), variant="light")
    note = "The same estimates through the flight logic, tick by tick; setpoints are compared with the recorded ones."
    return card("Replay", html.Div([dmc.Text(line) for line in lines], id="replayed", role="status"), again, note=note)


def _open_as_case(shown: Shown) -> Any:
    names = list(shown.logs)
    choose = dmc.Group(
        [
            dmc.Select(
                id={"field": "result-log"},
                label="Flight",
                data=[{"value": str(shown.logs[name]), "label": name} for name in names],
                value=str(shown.logs[names[0]]),
                searchable=True,
                allowDeselect=False,
                w=420,
            ),
            action("open-log", "Open it as a case", variant="light"),
        ],
        align="end",
    )
    return card("From a result to a better model", choose, note="A case begins with this flight, at its first step.")
