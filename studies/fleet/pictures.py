"""The pictures of a fleet: verdicts of each vehicle, and its drifts over the dates."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from studies.fleet.date import day_of
from studies.fleet.summary import VERDICTS, Drift, FleetReport, History, histories, labels
from studio.pages.figure import (
    AFTER,
    FLOOR,
    GREEN,
    MEASURED,
    ORANGE,
    PURPLE,
    VERMILION,
    Choice,
    Picture,
    choosing,
    picture,
)
from studio.pages.numbers import unit_shown

COLOURS = dict(zip(VERDICTS, (GREEN, AFTER, ORANGE, VERMILION, FLOOR, PURPLE), strict=True))
MAX_DRIFTS = 24  # of a picture's menu
MAX_VEHICLES = 60  # of the bars


def verdict_bars(report: FleetReport) -> Picture:
    """Number of flights by verdict, a bar a vehicle."""
    vehicles = report.vehicles[:MAX_VEHICLES]
    figure = go.Figure()
    for verdict in report.verdicts:
        figure.add_trace(
            go.Bar(
                y=[vehicle.label for vehicle in vehicles],
                x=[vehicle.verdicts.get(verdict, 0) for vehicle in vehicles],
                name=verdict,
                orientation="h",
                marker_color=COLOURS[verdict],
                hovertemplate="%{y}: %{x} " + verdict + "<extra></extra>",
            )
        )
    figure.update_layout(barmode="stack", legend_traceorder="normal")
    figure.update_xaxes(title_text="flights", rangemode="tozero")
    figure.update_yaxes(automargin=True, autorange="reversed")
    return picture(figure, 120 + 30 * len(vehicles), "Bars: number of flights of each vehicle by verdict.")


def drift_points(report: FleetReport) -> Picture | None:
    """A quantity of a vehicle over the dates, chosen from a menu, with its line; None where none has dated values."""
    drifts = report.drifts[:MAX_DRIFTS]
    if not drifts:
        return None
    distinct = [flight for flight in report.flights if flight.log not in report.copies]
    names = labels(distinct)
    series = {(names[one.owner], one.quantity): one for one in histories(distinct)}
    figure, choices = go.Figure(), []
    for drift in drifts:
        first = len(figure.data)
        _add_points(figure, drift, series[drift.vehicle, drift.quantity])
        unit = unit_shown(drift.unit)
        mark = "" if drift.is_drift else " (no sure drift)"
        title = f"{drift.quantity}, {unit}" if unit else drift.quantity
        choices.append(
            Choice(
                f"{drift.vehicle}: {drift.quantity}{mark}", range(first, len(figure.data)), {"yaxis.title.text": title}
            )
        )
    choosing(figure, choices, label="vehicle and quantity")
    figure.update_xaxes(type="date")
    figure.update_yaxes(title_text=choices[0].layout["yaxis.title.text"], automargin=True, exponentformat="power")
    return picture(figure, 420, "Points: a quantity of a vehicle by date of the flight, with the line of its drift.")


def _add_points(figure: go.Figure, drift: Drift, history: History) -> None:
    """A quantity's values with 95 % intervals, and the line of Theil and Sen."""
    rows = [place for place, flight in enumerate(history.flights) if flight.is_dated]
    rows.sort(key=lambda place: history.flights[place].date)
    dates = [history.flights[place].date for place in rows]
    values = np.array([history.values[place] for place in rows])
    figure.add_trace(
        go.Scatter(
            x=dates,
            y=values,
            error_y={"type": "data", "array": [1.96 * history.stds[place] for place in rows], "thickness": 1},
            mode="markers",
            name="flights",
            marker={"size": 7, "color": AFTER},
            text=[history.flights[place].log for place in rows],
            hovertemplate="%{text}<br>%{x}: %{y:.4g}<extra></extra>",
        )
    )
    days = np.array([day_of(date) for date in dates])
    level = float(np.median(values - drift.slope * days))
    ends = days[[0, -1]]
    figure.add_trace(
        go.Scatter(
            x=[dates[0], dates[-1]],
            y=level + drift.slope * ends,
            mode="lines",
            name="slope of Theil and Sen",
            line={"color": MEASURED, "width": 2, "dash": "solid" if drift.is_drift else "dot"},
            hoverinfo="skip",
        )
    )
