"""The picture of what a model followed in flight: each parameter over time with its 95 % interval, the disturbance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from diagnosis.report import Diagnosis, FollowedEffect, FollowedParameter
from diagnosis.thresholds import DEFAULT
from dynamics.arrays import Floats
from flights.followed import FollowedFlight
from studio.pages.figure import AFTER, BEFORE, FLOOR, GREEN, ORANGE, Picture
from studio.pages.numbers import unit_shown
from studio.pages.panels import add_band, add_line, panels_picture

AXES = "xyz"
COLOURS = (AFTER, ORANGE, GREEN)
SPACE = 0.3  # between two panels, over a panel's share of the height
MARGIN = 0.1  # of a panel above and below what it shows, over the range of that


def followed_picture(flight: FollowedFlight, effects: Sequence[FollowedEffect] = ()) -> Picture:
    """Parameters, disturbance, a network's last layer over time; dashed the values of the flight's diagnosis.

    effects: of this flight's diagnosis.
    """
    diagnosed = _diagnosed(effects)
    count = len(flight.names)
    titles = [*(_title(name, diagnosed.get(name)) for name in flight.names), "disturbance, m/s²", "disturbance, rad/s²"]
    if follows := bool(np.isfinite(flight.network).any()):
        titles += ["change of the network's last layer, m/s²", "forecast errors, m/s²"]
    rows = len(titles)
    figure = make_subplots(rows=rows, shared_xaxes=True, vertical_spacing=SPACE / rows, subplot_titles=titles)
    figure.update_annotations(x=0, xanchor="left", font_size=12)
    for row, name in enumerate(flight.names, start=1):
        _draw_parameter(figure, flight, name, row, diagnosed.get(name))
    for part, (unit, first) in enumerate((("m/s²", 0), ("rad/s²", 3))):
        for axis, name in enumerate(AXES):
            values = flight.disturbance[:, first + axis]
            add_line(figure, flight.time, values, name, COLOURS[axis], unit, count + 1 + part, legend=part == 0)
    if follows:
        _draw_network(figure, flight, count + 3)
    for edge in _edges(flight):
        figure.add_vline(x=float(flight.time[edge]), line={"color": FLOOR, "width": 1, "dash": "dot"})
    figure.update_yaxes(exponentformat="power")
    dashed_text = "; dashed: the diagnosis of the flight" if diagnosed else ""
    network_text = "; a network's last layer" if follows else ""
    text = f"Lines: parameters followed in flight with 95 % intervals{dashed_text}; disturbance{network_text}."
    return panels_picture(figure, rows, text, titles=True)


def effects_of(flight: FollowedFlight, diagnosis: Diagnosis) -> list[FollowedEffect]:
    """Verdict of a diagnosis on one flight's followed effects."""
    return [effect for effect in diagnosis.in_flight if effect.flight == flight.path.name]


def _draw_parameter(
    figure: go.Figure, flight: FollowedFlight, name: str, row: int, fitted: FollowedParameter | None
) -> None:
    place = flight.names.index(name)
    value, deviation = flight.value[:, place], flight.deviation[:, place]
    half = DEFAULT.in_flight.interval * deviation
    add_band(figure, flight.time, value, half, row)
    add_line(figure, flight.time, value, name, BEFORE, "" if fitted is None else fitted.unit, row, legend=False)
    figure.update_yaxes(range=_view(value, half, fitted), row=row, col=1)
    if fitted is not None:
        figure.add_hline(y=fitted.diagnosed, line={"color": AFTER, "dash": "dash", "width": 1.4}, row=row, col=1)


def _draw_network(figure: go.Figure, flight: FollowedFlight, row: int) -> None:
    """RMS of the last layer's change by axis; errors of forecasts with it and without."""
    for axis, name in enumerate(AXES):
        add_line(figure, flight.time, flight.network[:, axis], name, COLOURS[axis], "m/s²", row, legend=False)
    for place, (name, colour) in enumerate((("with the change", AFTER), ("without", BEFORE)), start=len(AXES)):
        add_line(figure, flight.time, flight.network[:, place], name, colour, "m/s²", row + 1)


def _title(name: str, fitted: FollowedParameter | None) -> str:
    unit = "" if fitted is None or fitted.unit == "1" else f", {unit_shown(fitted.unit)}"
    return f"{name}{unit}"


def _diagnosed(effects: Sequence[FollowedEffect]) -> Mapping[str, FollowedParameter]:
    """Parameters of a diagnosis by their names in the model."""
    keys = [(e, e.name if e.rotor is None else f"{e.name}[{e.rotor}]") for e in effects]
    return {f"{key}.{name}": parameter for effect, key in keys for name, parameter in effect.parameters.items()}


def _edges(flight: FollowedFlight) -> list[int]:
    """Rows at which tracking begins and ends, where something comes before or after it."""
    if not flight.tracked.any():
        return []
    edges = int(np.flatnonzero(flight.tracked)[0]), flight.last
    return [edge for edge in edges if 0 < edge < len(flight.time) - 1]


def _view(value: Floats, half: Floats, fitted: FollowedParameter | None) -> tuple[float, float] | None:
    """Lowest and highest value of a panel; None for all.

    From the rows whose interval is at most half of the widest: before them it is the prior's, which would flatten all
    that follows.
    """
    there = np.isfinite(value) & np.isfinite(half)
    if not there.any() or not half[there].max() > 0:
        return None
    narrow = there & (half <= DEFAULT.in_flight.max_unshown * half[there].max())
    rows = np.flatnonzero(narrow if narrow.any() else there)
    ends = [*(value[rows] - half[rows]), *(value[rows] + half[rows]), *([] if fitted is None else [fitted.diagnosed])]
    margin = MARGIN * (max(ends) - min(ends))
    return float(min(ends) - margin), float(max(ends) + margin)
