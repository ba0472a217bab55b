"""The first page: cases that there are, and new ones."""

from __future__ import annotations

import datetime
from typing import Any

import dash_mantine_components as dmc
from dash import dcc, html

from studio.app.log_page import drop_zone
from studio.app.parts import action, card
from studio.app.studio import Studio, name_of

RESULTS = (
    "A fleet, a sweep or a training (also while it runs), an evaluation, a recording: give the path of its folder or "
    "file on this computer."
)


def layout(studio: Studio) -> Any:
    """The list of cases, a new one, one from a file."""
    entries = studio.entries()
    rows = [
        html.Li(
            [
                dcc.Link(entry.name, href=f"/case/{name_of(entry.folder)}/log"),
                dmc.Text(
                    f" {datetime.datetime.fromtimestamp(entry.changed):%Y-%m-%d %H:%M}, {entry.folder}",
                    size="sm",
                    c="dimmed",
                    span=True,
                ),
            ]
        )
        for entry in entries
    ]
    new = dmc.Group(
        [
            dmc.TextInput(id={"field": "case-name"}, label="Name", placeholder="my quadrotor, November"),
            action("create", "New case"),
        ],
        align="end",
    )
    return dmc.Stack(
        [
            dmc.Title("Which effect does your model miss?", order=1, size="h2"),
            dmc.Text(
                "Bring flight logs and a vehicle file. Six steps lead from the logs to a model that predicts flights "
                "it was not fitted on. Everything stays on this computer."
            ),
            card(
                "For a first look",
                action("example", "Open an example", variant="light"),
                note="Two flights of a simulated PX4 quadrotor with twice the drag of its vehicle file.",
            ),
            card("A new case", new, note=f"A case is a folder; new ones are made in {studio.root}."),
            card("Cases", html.Ul(rows) if rows else dmc.Text("none yet", c="dimmed")),
            card("Look at a result", *_results(studio), note=RESULTS),
            card(
                "Open a case that somebody sent",
                drop_zone("archive", "/archive", "Drop the file (.alula.zip), or", goto="/case/ANSWER/log"),
            ),
        ],
        gap="md",
    )


def _results(studio: Studio) -> list[Any]:
    """A field for a path, and the results that are open."""
    ask = dmc.Group(
        [
            dmc.TextInput(id={"field": "result-path"}, label="Path", placeholder="logs.fleet", w=420),
            action("open-result", "Open"),
        ],
        align="end",
    )
    links = [html.Li(dcc.Link(str(path), href=f"/result/{name}")) for name, path in studio.results.items()]
    return [ask, html.Ul(links)] if links else [ask]
