"""Panels of one picture, one above the other over the same time."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from dynamics.arrays import Floats
from studio.pages.colours import FLOOR
from studio.pages.figure import Picture, line, picture, thinned

HEIGHT = 150  # px
SHADE = "rgba(128,128,128,0.3)"


def add_line(
    figure: go.Figure,
    time: Floats,
    values: Floats,
    name: str,
    colour: str,
    unit: str,
    row: int,
    *,
    legend: bool = True,
) -> None:
    """Draw values (n,) at times (n,) s in a panel. row: of the panel, from 1."""
    rows = thinned([values])
    drawn = line(time[rows], values[rows], name=name, colour=colour, unit=unit, showlegend=legend, legendgroup=name)
    figure.add_trace(drawn, row=row, col=1)


def add_band(figure: go.Figure, time: Floats, value: Floats, half: Floats, row: int) -> None:
    """Shade a band of half a width (n,) about values (n,) in a panel, where both are numbers."""
    there = np.isfinite(value) & np.isfinite(half)
    time, low, high = time[there], (value - half)[there], (value + half)[there]
    rows = thinned([low, high])
    x, low, high = time[rows], low[rows], high[rows]
    band = go.Scatter(
        x=np.concatenate([x, x[::-1]]),
        y=np.concatenate([high, low[::-1]]),
        fill="toself",
        fillcolor=SHADE,
        line={"width": 0},
        hoverinfo="skip",
        showlegend=False,
    )
    figure.add_trace(band, row=row, col=1)


def mark_phase(figure: go.Figure, start: float, name: str, rows: int) -> None:
    """A line through all panels where a phase begins, with its name at the top. start: s; rows: number of panels."""
    figure.add_vline(x=start, line={"color": FLOOR, "width": 1, "dash": "dot"})
    figure.add_annotation(
        x=start, y=1, yref="paper", xref=f"x{rows}" if rows > 1 else "x", text=name, showarrow=False,
        textangle=-90, xanchor="left", yanchor="top", font={"size": 9},
    )  # fmt: skip


def panels_picture(figure: go.Figure, rows: int, description: str, *, titles: bool = False) -> Picture:
    """The picture of a figure of panels. rows: their number. titles: whether they have titles."""
    figure.update_xaxes(title_text="time, s", row=rows, col=1)
    figure.update_layout(hovermode="x")
    return picture(figure, 90 + HEIGHT * rows, description, titles=titles)
