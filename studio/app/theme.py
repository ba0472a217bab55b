"""Light and dark: the same pictures in both, and the palette that everybody can tell apart."""

from __future__ import annotations

import json
from typing import Any, Literal

import plotly.graph_objects as go

from diagnosis.models.channels import KINDS
from studio.pages.figure import AFTER, BEFORE, BLACK, FLOOR, GREEN, ORANGE, PURPLE, SKY, VERMILION, YELLOW, Picture
from studio.work.results import PictureInfo

Scheme = Literal["light", "dark"]
INK = {"light": "#1c2430", "dark": "#e9ecef"}
PAPER = {"light": "#ffffff", "dark": "#1f2125"}
GRID = {"light": "#e5e7eb", "dark": "#3b3f46"}
MEASURED_LINE = {"light": BLACK, "dark": "#f1f3f5"}
SECOND_MODEL = GREEN
PRESENT, IMPROVED, BY_HAND, HIGHLIGHT, AXIS_COLOURS = BEFORE, AFTER, ORANGE, "#E69F00", (AFTER, ORANGE, GREEN)
KIND_COLOURS = dict(zip(KINDS, (PRESENT, SKY, GREEN, PURPLE), strict=True))
LINE_COLOURS = (SKY, ORANGE, GREEN, PURPLE, VERMILION, "#0072B2", "#8a8f98", YELLOW)
# what a picture of a static page is drawn with, and what stands in its place in the dark
DARK_INSTEAD = {
    "#000000": "#f1f3f5",
    "#1c2430": INK["dark"],
    "#ffffff": PAPER["dark"],
    "#e5e7eb": GRID["dark"],
    "#d4d8de": "#2c2f34",
    "#6b7280": "#adb5bd",
    "#0072B2": "#56B4E9",
}
CONFIG = {
    "displaylogo": False,
    "responsive": True,
    "scrollZoom": False,
    "modeBarButtonsToRemove": ["select2d", "lasso2d", "toImage"],
}
EMPTY = go.Figure(
    layout={
        "template": "none",
        "xaxis": {"visible": False},
        "yaxis": {"visible": False},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
    }
)


def figure_of(picture: PictureInfo | Picture, scheme: str, *, choice: str = "") -> dict[str, Any]:
    """A stored picture as a figure, in a scheme's colours. choice: which entry of its menu shows."""
    text = picture.data
    if scheme == "dark":
        for light, dark in DARK_INSTEAD.items():
            text = text.replace(light, dark)
    figure: dict[str, Any] = json.loads(text)
    layout = figure["layout"]
    for entry in (layout.get("meta") or {}).get("choices", []):
        if entry["name"] == choice:
            for trace, visible in zip(figure["data"], entry["visible"], strict=True):
                trace["visible"] = visible
    layout["autosize"] = True
    return figure


def choices_of(picture: PictureInfo | Picture) -> list[str]:
    """The entries of a picture's menu."""
    return [entry["name"] for entry in (json.loads(picture.data)["layout"].get("meta") or {}).get("choices", [])]


def styled(figure: go.Figure, scheme: str, *, height: int) -> go.Figure:
    """A figure of the app in the style of all pictures."""
    colour = "dark" if scheme == "dark" else "light"
    figure.update_layout(
        template="none",
        height=height,
        autosize=True,
        margin={"l": 62, "r": 12, "t": 28, "b": 44},
        font={"size": 12, "family": "system-ui, sans-serif", "color": INK[colour]},
        paper_bgcolor=PAPER[colour],
        plot_bgcolor=PAPER[colour],
        legend={"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom"},
        hoverlabel={"font_size": 12},
    )
    axis = {"gridcolor": GRID[colour], "zeroline": False, "linecolor": FLOOR, "title_standoff": 6}
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis, automargin=True)
    return figure


def measured_colour(scheme: str) -> str:
    """Of a measurement, black on white or white on black."""
    return MEASURED_LINE["dark" if scheme == "dark" else "light"]


def improved_colour(scheme: str) -> str:
    """Of the improved model."""
    return SKY if scheme == "dark" else IMPROVED
