"""Pictures of a recorded flight: tracking, timing of the controller, health, and what the model followed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from dynamics.arrays import Floats
from studies.results.recorded_flight import RecordedFlight
from studio.pages.figure import (
    AFTER,
    BEFORE,
    FLOOR,
    GREEN,
    MEASURED,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    Picture,
    line,
    picture,
    thinned,
)

AXES = "xyz"
COLOURS = (AFTER, ORANGE, GREEN, PURPLE, SKY, VERMILION)
INTERVAL = 1.96  # standard deviations of a 95 % interval
PANEL = 150  # px


def tracking_picture(flight: RecordedFlight) -> Picture:
    """Position and reference, axis by axis, and the distance between them."""
    figure = make_subplots(rows=4, shared_xaxes=True, vertical_spacing=0.03)
    for axis, name in enumerate(AXES):
        for values, label, colour in (
            (flight.reference[:, axis], "reference", MEASURED),
            (flight.position[:, axis], "estimate", BEFORE),
        ):
            _add(figure, flight.time, values, label, colour, "m", axis + 1, legend=axis == 0)
        figure.update_yaxes(title_text=f"{name}, m", row=axis + 1, col=1)
    _add(figure, flight.time, 100 * flight.distance, "distance", VERMILION, "cm", 4, legend=False)
    figure.update_yaxes(title_text="distance, cm", rangemode="tozero", row=4, col=1)
    _mark_phases(figure, flight, 4)
    return _finished(figure, 4, "Lines: position, reference and their distance over time.")


def timing_picture(flight: RecordedFlight) -> Picture:
    """Durations of each tick, the estimate's age, and the time from its arrival to the setpoint's departure."""
    ticks = flight.ticks
    figure = make_subplots(rows=2, shared_xaxes=True, vertical_spacing=0.05)
    for field, name, colour in (
        ("departure_seconds", "trigger to setpoint", BEFORE),
        ("feedback_seconds", "feedback", AFTER),
        ("preparation_seconds", "preparation", GREEN),
    ):
        _add(figure, flight.tick_time, 1e3 * ticks[field], name, colour, "ms", 1)
    _add(figure, flight.tick_time, 1e3 * ticks["estimate_age"], "age of the estimate", ORANGE, "ms", 2)
    figure.update_yaxes(title_text="ms", type="log", exponentformat="power")
    return _finished(figure, 2, "Lines: durations of the controller's phases and age of the estimate, by tick.")


def health_picture(flight: RecordedFlight) -> Picture | None:
    """The learned model's error over that in training, the thrust's effectiveness, the battery; None without any."""
    panels: list[tuple[str, Floats, Floats, str]] = []
    if np.isfinite(flight.ticks["model_ratio"]).any():
        panels.append(("model's error / in training", flight.tick_time, flight.ticks["model_ratio"], BEFORE))
    for table, field, title, colour in (
        (flight.setpoints, "effectiveness", "thrust / modelled thrust", AFTER),
        (flight.battery, "voltage", "battery, V", GREEN),
    ):
        if len(table.get("time", ())):
            panels.append((title, table["time"] - flight.start, table[field], colour))
    if not panels:
        return None
    figure = make_subplots(rows=len(panels), shared_xaxes=True, vertical_spacing=0.05)
    for row, (title, time, values, colour) in enumerate(panels, start=1):
        _add(figure, time, values, title, colour, "", row, legend=False)
        figure.update_yaxes(title_text=title, row=row, col=1)
    return _finished(figure, len(panels), "Lines: health of model, thrust and battery over time.")


def followed_picture(flight: RecordedFlight) -> Picture | None:
    """Parameters that the model followed with 95 % intervals, and the disturbance; None for a flight without."""
    followed = flight.followed
    if not len(followed.get("time", ())):
        return None
    time, names = followed["time"] - flight.start, flight.followed_names
    figure = make_subplots(rows=len(names) + 2, shared_xaxes=True, vertical_spacing=0.025)
    for row, name in enumerate(names, start=1):
        value, deviation = followed["value"][:, row - 1], followed["deviation"][:, row - 1]
        _add_band(figure, time, value, INTERVAL * deviation, row)
        _add(figure, time, value, name, BEFORE, "", row, legend=False)
        figure.update_yaxes(title_text=name.replace(".", "<br>"), row=row, col=1)
    disturbance = followed["staying"] + followed["fading"]
    for part, (unit, first) in enumerate((("m/s²", 0), ("rad/s²", 3))):
        row = len(names) + 1 + part
        for axis, name in enumerate(AXES):
            _add(figure, time, disturbance[:, first + axis], name, COLOURS[axis], unit, row, legend=part == 0)
        figure.update_yaxes(title_text=f"disturbance, {unit}", row=row, col=1)
    return _finished(figure, len(names) + 2, "Lines: parameters followed in flight with 95 % intervals; disturbance.")


def _add(
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
    rows = thinned([values])
    drawn = line(time[rows], values[rows], name=name, colour=colour, unit=unit, showlegend=legend, legendgroup=name)
    figure.add_trace(drawn, row=row, col=1)


def _add_band(figure: go.Figure, time: Floats, value: Floats, half: Floats, row: int) -> None:
    rows = thinned([value - half, value + half])
    x, low, high = time[rows], (value - half)[rows], (value + half)[rows]
    band = go.Scatter(
        x=np.concatenate([x, x[::-1]]),
        y=np.concatenate([high, low[::-1]]),
        fill="toself",
        fillcolor="rgba(128,128,128,0.3)",
        line={"width": 0},
        hoverinfo="skip",
        showlegend=False,
    )
    figure.add_trace(band, row=row, col=1)


def _mark_phases(figure: go.Figure, flight: RecordedFlight, rows: int) -> None:
    """A line where each phase of the mission begins, with its name at the top."""
    for start, phase in flight.phases:
        figure.add_vline(x=start, line={"color": FLOOR, "width": 1, "dash": "dot"})
        figure.add_annotation(
            x=start, y=1, yref="paper", xref=f"x{rows}" if rows > 1 else "x", text=phase, showarrow=False,
            textangle=-90, xanchor="left", yanchor="top", font={"size": 9},
        )  # fmt: skip


def _finished(figure: go.Figure, rows: int, description: str) -> Picture:
    figure.update_xaxes(title_text="time, s", row=rows, col=1)
    figure.update_layout(hovermode="x")
    return picture(figure, 90 + PANEL * rows, description)


def quantiles(values: Sequence[float] | Floats) -> tuple[float, float, float, float]:
    """Median, 95th and 99th percentile, and the largest of the finite values; NaN without any."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if not len(finite):
        return (np.nan,) * 4
    return tuple(float(v) for v in (*np.percentile(finite, (50, 95, 99)), finite.max()))  # type: ignore[return-value]
