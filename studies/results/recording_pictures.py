"""Pictures of a recorded flight: tracking, timing of the controller, health."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from plotly.subplots import make_subplots

from dynamics.arrays import Floats
from studies.results.recorded_flight import RecordedFlight
from studio.pages.figure import AFTER, BEFORE, GREEN, MEASURED, ORANGE, VERMILION, Picture
from studio.pages.panels import add_line, mark_phase, panels_picture

AXES = "xyz"


def tracking_picture(flight: RecordedFlight) -> Picture:
    """Position and reference, axis by axis, and the distance between them."""
    figure = make_subplots(rows=4, shared_xaxes=True, vertical_spacing=0.03)
    for axis, name in enumerate(AXES):
        for values, label, colour in (
            (flight.reference[:, axis], "reference", MEASURED),
            (flight.position[:, axis], "estimate", BEFORE),
        ):
            add_line(figure, flight.time, values, label, colour, "m", axis + 1, legend=axis == 0)
        figure.update_yaxes(title_text=f"{name}, m", row=axis + 1, col=1)
    add_line(figure, flight.time, 100 * flight.distance, "distance", VERMILION, "cm", 4, legend=False)
    figure.update_yaxes(title_text="distance, cm", rangemode="tozero", row=4, col=1)
    for start, phase in flight.phases:
        mark_phase(figure, start, phase, 4)
    return panels_picture(figure, 4, "Lines: position, reference and their distance over time.")


def timing_picture(flight: RecordedFlight) -> Picture:
    """Durations of each tick, the estimate's age, and the time from its arrival to the setpoint's departure."""
    ticks = flight.ticks
    figure = make_subplots(rows=2, shared_xaxes=True, vertical_spacing=0.05)
    for field, name, colour in (
        ("departure_seconds", "trigger to setpoint", BEFORE),
        ("feedback_seconds", "feedback", AFTER),
        ("preparation_seconds", "preparation", GREEN),
    ):
        add_line(figure, flight.tick_time, 1e3 * ticks[field], name, colour, "ms", 1)
    add_line(figure, flight.tick_time, 1e3 * ticks["estimate_age"], "age of the estimate", ORANGE, "ms", 2)
    figure.update_yaxes(title_text="ms", type="log", exponentformat="power")
    return panels_picture(figure, 2, "Lines: durations of the controller's phases and age of the estimate, by tick.")


def health_picture(flight: RecordedFlight) -> Picture | None:
    """The learned model's error and certainty, the thrust's effectiveness, the battery; None without any."""
    panels: list[tuple[str, Floats, Floats, str]] = []
    for field, title, colour in (
        ("model_ratio", "model's error / in training", BEFORE),
        ("model_uncertainty", "members' disagreement / limit", ORANGE),
        ("network_share", "share of the network flown", GREEN),
    ):
        values = flight.ticks.get(field)  # recordings of older versions lack some
        if values is not None and np.isfinite(values.astype(float)).any():
            panels.append((title, flight.tick_time, values.astype(float), colour))
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
        add_line(figure, time, values, title, colour, "", row, legend=False)
        figure.update_yaxes(title_text=title, row=row, col=1)
    return panels_picture(figure, len(panels), "Lines: health of model, thrust and battery over time.")


def quantiles(values: Sequence[float] | Floats) -> tuple[float, float, float, float]:
    """Median, 95th and 99th percentile, and the largest of the finite values; NaN without any."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if not len(finite):
        return (np.nan,) * 4
    return tuple(float(v) for v in (*np.percentile(finite, (50, 95, 99)), finite.max()))  # type: ignore[return-value]
