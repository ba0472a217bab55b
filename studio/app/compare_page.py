"""Step 3: measurement and model in linked panels, where the model fails, and the seconds behind every cell."""

from __future__ import annotations

from typing import Any

import dash
import dash_mantine_components as dmc
from dash import dcc, html

from diagnosis.models.channels import NAMES
from studio.app import compare_lines, compare_map
from studio.app.heads import head, lock, refusal
from studio.app.opened import OpenCase
from studio.app.parts import action, card, command_box, graph, grid, out_of_date
from studio.app.studio import Studio
from studio.app.theme import figure_of
from studio.pages.numbers import quantity_shown, unit_shown
from studio.work.results import Compared

TITLES = {
    "spectrum": "Residual spectra against the noise",
    "agreement": "Accelerometer against pose",
    "bars": "Error of each channel over its floor",
}


def layout(opened: OpenCase, name: str, scheme: str) -> Any:
    """Panels, worst seconds, maps, path, spectra."""
    parts = head(opened, "Where does the model fail?")
    refused = refusal(opened, "compare", "These flights cannot answer", colour="red")
    compared, folder = opened.result(Compared, "compare"), opened.case.shown_result("compare")
    if refused or compared is None or folder is None:
        return dmc.Stack(parts + (refused or _waiting(opened)), gap="md")
    if not opened.is_fresh("compare"):
        parts.append(out_of_date("compare", running=opened.job is not None))
    parts += [
        _summary(compared),
        compare_lines.panels(opened, compared, folder),
        compare_map.map_card(compared),
        compare_map.path_card(compared, folder, scheme),
        *_pictures(compared, scheme),
    ]
    if compared.comparison.notes:
        parts.append(card("Notes", html.Ul([html.Li(note) for note in compared.comparison.notes])))
    parts.append(dcc.Link("Next: which effect is missing?", href=f"/case/{name}/diagnose"))
    parts.append(command_box(opened.command("compare")))
    return dmc.Stack(parts, gap="md")


def _waiting(opened: OpenCase) -> list[Any]:
    """Placeholder before the first result."""
    if locked := lock(opened, "compare"):
        return locked
    if opened.job is not None:
        return [dmc.Text("The model is evaluated along the flights.", c="dimmed")]
    return [action("start", "Compare", step="compare")]


def _pictures(compared: Compared, scheme: str) -> list[Any]:
    """Spectra, agreement of the sensors, bars, and error over two quantities."""
    drawn = {
        key: graph(f"compare-{key}", figure_of(picture, scheme), picture.description)
        for key, picture in compared.pictures.items()
        if key in TITLES or key.startswith("plane_")
    }
    cards = [card(title, drawn[key]) for key, title in TITLES.items() if key in drawn]
    planes = [picture for key, picture in drawn.items() if key.startswith("plane_")]
    return [grid(*cards), card("Error over two quantities at once", grid(*planes, width=340))]


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


def register(app: dash.Dash, studio: Studio) -> None:
    """The callbacks of the linked panels, and of the map and the path."""
    compare_lines.register(app, studio)
    compare_map.register(app, studio)
