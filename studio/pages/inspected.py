"""The page of `alula inspect --html`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import plotly.graph_objects as go

from dynamics.arrays import Floats
from flights import Flight
from flights.quality import Inspection
from studio.pages.figure import (
    AFTER,
    BLACK,
    FLOOR,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    UNFLOWN,
    VERMILION,
    YELLOW,
    Picture,
    picture,
    thinned,
)
from studio.pages.flight_panels import (
    drawn_columns,
    height_of,
    panels_figure,
    place_legends,
    quantities_of,
    shown_panels,
)
from studio.pages.page import Origin, render

COLOURS = (AFTER, ORANGE, GREEN, PURPLE, SKY, VERMILION, BLACK, YELLOW)


@dataclass(frozen=True)
class Section:
    """One log's verdict and its pictures; None where the log has nothing to draw."""

    inspection: Inspection
    flight: Picture | None
    delays: Picture | None
    coverage: tuple[Picture, ...]


def section(inspection: Inspection, flight: Flight) -> Section:
    """The part of the page that is about one log."""
    return Section(inspection, _flight_lines(inspection, flight), delay_points(inspection), coverage_maps(inspection))


def inspection_page(sections: Sequence[Section], *, origin: Origin) -> str:
    """The page of these logs."""
    count = len(sections)
    title = f"Alula: inspection of {count} log{'' if count == 1 else 's'}"
    return render("inspection.html", title=title, origin=origin, sections=sections)


def _flight_lines(inspection: Inspection, flight: Flight) -> Picture | None:
    panels = shown_panels(quantities_of(flight))
    if not panels:
        return None
    columns = drawn_columns(flight)

    def points(name: str) -> tuple[Floats, Floats]:
        rows = thinned([columns[name]])
        return flight.time[rows].astype(np.float32), columns[name][rows].astype(np.float32)

    figure = panels_figure(panels, points, COLOURS)
    for item in inspection.exclusions:
        figure.add_vrect(x0=item.start, x1=item.stop, fillcolor="#718096", opacity=0.25, line_width=0)
    places = range(1, len(panels) + 1)
    return picture(
        figure,
        height_of(len(panels)),
        "Lines: the log's quantities over time.",
        legends=lambda drawn: place_legends(drawn, places),
    )


def delay_points(inspection: Inspection) -> Picture | None:
    """Delays between a log's streams; None where none was estimated."""
    if not inspection.delays:
        return None
    figure = go.Figure()
    for delay in inspection.delays:
        kind = "lag of the response" if delay.is_response else "late"
        reach = 1e3 * (delay.high - delay.low) / 2
        figure.add_trace(
            go.Scatter(
                x=[1e3 * delay.seconds],
                y=[f"{delay.stream}<br>to {delay.against}"],
                mode="markers",
                name=kind,
                error_x={"type": "data", "array": [reach]},
                showlegend=False,
                marker={"size": 9, "color": ORANGE if delay.is_response else AFTER},
                hovertemplate=f"{kind}: %{{x:.2f}} ± {reach:.2f} ms<extra></extra>",
            )
        )
    figure.update_xaxes(title_text="ms by which stamps are late (blue),<br>or by which a response lags (orange)")
    figure.add_vline(x=0, line={"color": FLOOR, "width": 1})
    figure.update_yaxes(automargin=True, autorange="reversed")
    return picture(figure, 90 + 48 * len(inspection.delays), "Points with bars: delays between the log's streams.")


def coverage_maps(inspection: Inspection) -> tuple[Picture, ...]:
    """Where a log's time was spent."""
    pictures = []
    for cells in inspection.coverage:
        seconds = np.array(cells.seconds)
        across, up = cells.column_name.removesuffix(" 1"), cells.row_name.removesuffix(" 1")
        figure = go.Figure(
            go.Heatmap(
                z=np.log10(np.where(seconds > 0, seconds, np.nan)),
                x=_ranges(cells.column_edges),
                y=_ranges(cells.row_edges),
                colorscale="Cividis",
                showscale=False,
                customdata=seconds,
                hovertemplate="%{y}, %{x}: %{customdata:.1f} s<extra></extra>",
                xgap=1,
                ygap=1,
                text=[[f"{value:.1f} s" if value > 0 else "" for value in row] for row in seconds],
                texttemplate="%{text}",
                textfont_size=10,
            )
        )
        figure.update_xaxes(title_text=across, type="category", automargin=True)
        figure.update_yaxes(title_text=up, type="category", automargin=True)
        figure.update_layout(plot_bgcolor=UNFLOWN)
        pictures.append(picture(figure, 380, f"Map: seconds flown by {across} and {up}."))
    return tuple(pictures)


def _ranges(edges: Sequence[float]) -> list[str]:
    return [f"{low:g} to {high:g}" for low, high in pairwise(edges)]
