"""The page of `alula inspect --html`: one file with its plots inside, which needs no network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import jinja2
import numpy as np
import plotly.graph_objects as go
from plotly import offline
from plotly.subplots import make_subplots

from dynamics.errors import RequestError
from flights import Flight
from flights.log import Floats
from flights.verdict import Inspection

TEMPLATE = "inspection_page.html"
MOST_POINTS = 3000  # a line
ROWS = (
    ("velocity", "velocity m/s"), ("rate", "body rate rad/s"), ("specific_force", "specific force m/s²"),
    ("rotor_speed", "rotor speed rad/s"), ("rotor_speed_command", "rotor command rad/s"),
    ("rotor_thrust_command", "rotor command N"), ("rotor_command", "rotor command 0..1"),
    ("battery_voltage", "battery V"),
)  # fmt: skip
COLOURS = ("#2b6cb0", "#c05621", "#2f855a", "#805ad5", "#b83280", "#4a5568", "#b7791f", "#319795")
CONFIG = {"displaylogo": False, "responsive": True}


@dataclass(frozen=True)
class Section:
    """One log's verdict and its plots as HTML."""

    inspection: Inspection
    flight: str
    delays: str
    coverage: str


def section(inspection: Inspection, flight: Flight) -> Section:
    """The part of the page that is about one log."""
    return Section(inspection, _flight_plot(inspection, flight), _delay_plot(inspection), _coverage_plot(inspection))


def write_page(sections: Sequence[Section], path: Path) -> None:
    """Write the page. Raises RequestError when it cannot be written."""
    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    text = environment.get_template(TEMPLATE).render(sections=sections, plotly=offline.get_plotlyjs())
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise RequestError(f"cannot write {path}: {error.strerror or error}. Give another file to --html.") from error


def _flight_plot(inspection: Inspection, flight: Flight) -> str:
    rows = [(name, title) for name, title in ROWS if flight.has(name)]
    if not rows:
        return ""
    figure = make_subplots(rows=len(rows), shared_xaxes=True, vertical_spacing=0.03)
    for row, (name, title) in enumerate(rows, start=1):
        values = flight[name].reshape(len(flight), -1)
        labels = [column for column in flight.columns if column.startswith(f"{name}_")] or [name]
        for index, (column, label) in enumerate(zip(values.T, labels, strict=False)):
            time, thinned = _thinned(flight.time, column)
            line = {"color": COLOURS[index % len(COLOURS)], "width": 1}
            figure.add_trace(
                go.Scattergl(x=time, y=thinned, name=label, line=line, mode="lines", showlegend=False), row=row, col=1
            )
        figure.update_yaxes(title_text=title, title_font_size=11, row=row, col=1)
    for item in inspection.exclusions:
        figure.add_vrect(x0=item.start, x1=item.stop, fillcolor="#718096", opacity=0.25, line_width=0)
    figure.update_xaxes(title_text="s", row=len(rows), col=1)
    return _html(figure, 150 * len(rows) + 60)


def _delay_plot(inspection: Inspection) -> str:
    if not inspection.delays:
        return ""
    figure = go.Figure()
    for delay in inspection.delays:
        kind = "lag of the response" if delay.is_response else "late"
        reach = 1e3 * (delay.high - delay.low) / 2
        figure.add_trace(go.Scatter(
            x=[1e3 * delay.seconds], y=[f"{delay.stream} against {delay.against}"], mode="markers", name=kind,
            error_x={"type": "data", "array": [reach]}, showlegend=False,
            marker={"size": 9, "color": COLOURS[1] if delay.is_response else COLOURS[0]},
            hovertemplate=f"{kind}: %{{x:.2f}} ± {reach:.2f} ms<extra></extra>",
        ))  # fmt: skip
    figure.update_xaxes(
        title_text="ms by which stamps are late (blue), or lag of a command's response (orange)", zeroline=True
    )
    figure.update_yaxes(automargin=True, autorange="reversed")
    return _html(figure, 60 + 45 * len(inspection.delays))


def _coverage_plot(inspection: Inspection) -> str:
    maps = inspection.coverage
    if not maps:
        return ""
    figure = make_subplots(cols=len(maps), horizontal_spacing=0.12)
    for index, cells in enumerate(maps, start=1):
        seconds = np.array(cells.seconds)
        shown = np.where(seconds > 0, seconds, np.nan)
        figure.add_trace(go.Heatmap(
            z=np.log10(shown), x=_ranges(cells.column_edges), y=_ranges(cells.row_edges), colorscale="Blues",
            showscale=False, customdata=seconds, hovertemplate="%{y}, %{x}: %{customdata:.1f} s<extra></extra>",
            text=[[f"{value:.1f} s" if value > 0 else "" for value in line] for line in seconds],
            texttemplate="%{text}",
        ), row=1, col=index)  # fmt: skip
        figure.update_xaxes(title_text=cells.column_name.removesuffix(" 1"), type="category", row=1, col=index)
        figure.update_yaxes(title_text=cells.row_name, type="category", row=1, col=index)
    figure.update_layout(plot_bgcolor="#edf0f3")
    return _html(figure, 380)


def _ranges(edges: Sequence[float]) -> list[str]:
    return [f"{low:g} to {high:g}" for low, high in pairwise(edges)]


def _thinned(time: Floats, values: Floats) -> tuple[Floats, Floats]:
    """A line of few points that still shows every spike: the least and the greatest of each of many pieces."""
    if len(time) <= MOST_POINTS:
        return time, values
    pieces = MOST_POINTS // 2
    size = len(time) // pieces
    table = values[: pieces * size].reshape(pieces, size)
    known = np.isfinite(table)
    low = np.argmin(np.where(known, table, np.inf), axis=1)
    high = np.argmax(np.where(known, table, -np.inf), axis=1)
    chosen = np.sort(np.stack([low, high]), axis=0).T + size * np.arange(pieces)[:, None]
    return time[chosen.ravel()], values[chosen.ravel()]


def _html(figure: go.Figure, height: int) -> str:
    figure.update_layout(
        height=height, margin={"l": 60, "r": 20, "t": 20, "b": 45}, template="plotly_white", font={"size": 12}
    )
    return str(figure.to_html(full_html=False, include_plotlyjs=False, config=CONFIG))
