"""The panels of a log's picture: a quantity each with its setpoint, a legend above each panel."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from dynamics.arrays import Floats
from dynamics.quaternion import to_euler
from flights import Flight
from flights.quantities import quantity_of

PANEL, GAP, MARGIN = 110, 36, 72  # px: of a panel, between two with the lower one's legend, above and below all
ANGLES, ANGLES_SETPOINT = "angles", "angles_setpoint"  # roll, pitch and yaw of a flight's attitudes
EULER = ("roll", "pitch", "yaw")
TURN = 2 * np.pi  # rad


@dataclass(frozen=True)
class Panel:
    """A panel. setpoint: quantity that is drawn dashed beside the panel's own, empty where there is none."""

    quantity: str
    title: str
    unit: str
    setpoint: str = ""

    @property
    def axis_title(self) -> str:
        """Title with unit."""
        return f"{self.title}, {self.unit}" if self.unit else self.title


@dataclass(frozen=True)
class PanelLine:
    """A line of a panel. column: of the table; label: in the legend; colour: its place in a palette."""

    column: str
    label: str
    colour: int
    is_setpoint: bool


PANELS = (
    Panel("position", "position", "m", "position_setpoint"),
    Panel("velocity", "velocity", "m/s", "velocity_setpoint"),
    Panel(ANGLES, "attitude", "rad", ANGLES_SETPOINT),
    Panel("rate", "body rate", "rad/s", "rate_setpoint"),
    Panel("specific_force", "specific force", "m/s²"),
    Panel("rotor_speed", "rotor speed", "rad/s"),
    Panel("rotor_speed_command", "rotor command", "rad/s"),
    Panel("rotor_thrust_command", "rotor command", "N"),
    Panel("rotor_command", "rotor command", ""),
    Panel("thrust_setpoint", "thrust setpoint", ""),
    Panel("battery_voltage", "battery", "V"),
)


def quantities_of(flight: Flight) -> dict[str, str]:
    """The quantity of each column of `drawn_columns`."""
    kinds = {name: kind.name for name in flight.columns if (kind := quantity_of(name)) is not None}
    return kinds | {name: name.rpartition("_")[0] for name in angles_of(flight)}


def drawn_columns(flight: Flight) -> dict[str, Floats]:
    """A flight's columns (n,), with roll, pitch and yaw of its attitude and of the attitude's setpoint, rad."""
    return {**flight.columns, **angles_of(flight)}


def angles_of(flight: Flight) -> dict[str, Floats]:
    """Columns of roll, pitch and yaw (n,), rad, without jumps by a whole turn; a setpoint's nearest to its angle."""
    columns: dict[str, Floats] = {}
    own = _angles(flight["attitude"]) if flight.has("attitude") else None
    if own is None and flight.has(*EULER):
        own = np.stack([_unwrapped(flight[name]) for name in EULER], axis=1)
    if own is not None:
        columns |= {f"{ANGLES}_{name}": own[:, place] for place, name in enumerate(EULER)}
    if flight.has("attitude_setpoint"):
        setpoint = _angles(flight["attitude_setpoint"])
        if own is not None:
            setpoint = setpoint + TURN * np.nan_to_num(np.round((own - setpoint) / TURN))
        columns |= {f"{ANGLES_SETPOINT}_{name}": setpoint[:, place] for place, name in enumerate(EULER)}
    return columns


def shown_panels(quantities: Mapping[str, str]) -> list[tuple[Panel, list[PanelLine]]]:
    """The panels of a table and their lines. quantities: by the names of its columns, in their order."""
    lines = [(panel, panel_lines(panel, quantities)) for panel in PANELS if panel.quantity in quantities.values()]
    return [(panel, drawn) for panel, drawn in lines if drawn]


def panel_lines(panel: Panel, quantities: Mapping[str, str]) -> list[PanelLine]:
    """The lines of a panel: its quantity's columns, then those of the setpoint."""
    lines = []
    for quantity in filter(None, (panel.quantity, panel.setpoint)):
        columns = [name for name, kind in quantities.items() if kind == quantity]
        is_setpoint = quantity == panel.setpoint
        for colour, name in enumerate(columns):
            label = name.removeprefix(quantity).lstrip("_") or panel.title
            lines.append(PanelLine(name, f"{label} setpoint" if is_setpoint else label, colour, is_setpoint))
    return lines


def height_of(count: int) -> int:
    """The height of a picture of so many panels, px."""
    return MARGIN + PANEL * count + GAP * (count - 1)


def panels_figure(
    shown: Sequence[tuple[Panel, Sequence[PanelLine]]],
    points: Callable[[str], tuple[Any, Any]],
    colours: Sequence[str],
) -> go.Figure:
    """The panels of a table. points: x and y of a column's line."""
    count = max(1, len(shown))
    spacing = GAP / (height_of(count) - MARGIN)
    figure = make_subplots(rows=count, shared_xaxes=True, vertical_spacing=spacing)
    for row, (panel, lines) in enumerate(shown, start=1):
        for number, line in enumerate(lines):
            x, y = points(line.column)
            first_setpoint = line.is_setpoint and not lines[number - 1].is_setpoint
            figure.add_trace(
                go.Scatter(
                    x=x,
                    y=y,
                    name="setpoint" if line.is_setpoint else line.label,
                    legend=f"legend{row}" if row > 1 else "legend",
                    legendgroup=f"setpoints {row}" if line.is_setpoint else None,
                    showlegend=first_setpoint or not line.is_setpoint,
                    mode="lines",
                    line={
                        "color": colours[line.colour % len(colours)],
                        "width": 1.1,
                        "dash": "dot" if line.is_setpoint else "solid",
                    },
                    hovertemplate=f"{line.label}: %{{y:.4g}} {panel.unit}<extra></extra>",
                ),
                row=row,
                col=1,
            )
        figure.update_yaxes(title_text=panel.axis_title, title_font_size=11, row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=count, col=1)
    return figure


def place_legends(figure: go.Figure, rows: Sequence[int]) -> go.Figure:
    """A legend above each of these panels, counted from 1."""
    for row in rows:
        place = "" if row == 1 else str(row)
        top = figure.layout[f"yaxis{place}"].domain[1]
        legend = {"orientation": "h", "x": 0, "y": top, "yanchor": "bottom", "font": {"size": 11}}
        figure.update_layout({f"legend{place}": legend})
    return figure


def _angles(attitude: Floats) -> Floats:
    """(n, 3) roll, pitch and yaw of attitudes (n, 4), NaN where there is none."""
    return np.stack([_unwrapped(column) for column in to_euler(attitude).T], axis=1)


def _unwrapped(angle: Floats) -> Floats:
    """Angles (n,) without jumps by a whole turn, NaN where they are NaN."""
    angle = np.array(angle, dtype=float)
    finite = np.isfinite(angle)
    angle[finite] = np.unwrap(angle[finite])
    return angle
