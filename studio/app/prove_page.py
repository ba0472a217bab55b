"""Step 6: held-out errors and open loop before and after, the bundle, and a flight on the mock with both models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import dash_mantine_components as dmc
import numpy as np
import plotly.graph_objects as go
from dash import html
from plotly.subplots import make_subplots

from diagnosis.models.channels import NAMES
from diagnosis.models.open_loop import HorizonError
from diagnosis.proof import Proof
from simulation.versions_in_flight import VersionsInFlight
from studio.app.heads import head, lock, refusal
from studio.app.opened import OpenCase
from studio.app.parts import action, card, command_box, graph, out_of_date, table
from studio.app.theme import PRESENT, improved_colour, measured_colour, styled
from studio.pages.numbers import unit_shown
from studio.work.results import Exported

REFERENCES = ("Lemniscate", "Ellipse_1", "hover")
UNITS = {"position": "m", "velocity": "m/s", "attitude": "rad", "rate": "rad/s"}


def layout(opened: OpenCase, name: str, scheme: str) -> Any:
    """Gain of the additions on flights that nothing was fitted to, and in the controller."""
    parts = head(opened, "Prove it")
    if locked := lock(opened, "prove"):
        return dmc.Stack(parts + locked, gap="md")
    running = opened.job is not None
    parts.append(_held_out(opened, scheme, running=running))
    parts.append(_mock(opened, scheme, running=running))
    parts.append(_bundle(opened, running=running))
    return dmc.Stack(parts, gap="md")


def _held_out(opened: OpenCase, scheme: str, *, running: bool) -> Any:
    title = "On flights that nothing was fitted to"
    if refused := refusal(opened, "prove", "Not proved"):
        return card(title, *refused)
    proved = opened.result(Proof, "prove")
    if proved is None:
        return card(title, action("start", "Compare both versions", step="prove", disabled=running))
    rows = [
        {
            "channel": NAMES[kind],
            "before": f"{error.before:.4g}",
            "after": f"{error.after:.4g}",
            "floor": f"{error.floor:.4g}",
            "unit": unit_shown(error.unit),
            "change": f"{100 * (error.after / error.before - 1):+.1f} %",
        }
        for kind, error in proved.channels.items()
    ]
    columns = [{"field": key, "headerName": key} for key in ("channel", "before", "after", "change", "floor", "unit")]
    banner = [] if opened.is_fresh("prove") else [out_of_date("prove", running=running)]
    drawn = []
    if proved.open_loop.before:
        figure = _open_loop_figure(proved.open_loop.before, proved.open_loop.after, scheme)
        drawn = [graph("open-loop", figure, "Lines: prediction error over the horizon, before and after")]
    note = "RMS of each channel, and of predictions without later measurements."
    command = command_box(opened.command("prove"))
    return card(title, *banner, table("proved", rows, columns), *drawn, command, note=note)


def _open_loop_figure(before: Sequence[HorizonError], after: Sequence[HorizonError], scheme: str) -> go.Figure:
    titles = [f"{name}, {unit}" for name, unit in UNITS.items()]
    figure = make_subplots(cols=2, rows=2, subplot_titles=titles, vertical_spacing=0.2)
    for number, quantity in enumerate(UNITS):
        for label, colour, errors in (("before", PRESENT, before), ("after", improved_colour(scheme), after)):
            drawn = go.Scatter(
                x=[e.horizon for e in errors],
                y=[getattr(e, quantity) for e in errors],
                name=label,
                legendgroup=label,
                showlegend=number == 0,
                mode="lines+markers",
                line={"color": colour, "width": 2},
            )
            figure.add_trace(drawn, row=number // 2 + 1, col=number % 2 + 1)
    figure.update_xaxes(title_text="horizon, s")
    figure.update_yaxes(rangemode="tozero")
    styled(figure, scheme, height=520)
    figure.update_layout(legend={"y": 1.08})
    return figure


def _mock(opened: OpenCase, scheme: str, *, running: bool) -> Any:
    choose = dmc.Group(
        [
            dmc.Select(
                id={"field": "reference"},
                label="Manoeuvre",
                data=list(REFERENCES),
                value=REFERENCES[0],
                allowDeselect=False,
                w=200,
            ),
            action("start", "Fly it on the mock", step="fly", disabled=running),
        ],
        align="end",
    )
    flown = []
    for reference in REFERENCES:
        step = f"fly:{reference}"
        result = opened.result(VersionsInFlight, step, shown=False)
        flown += refusal(opened, step, f"{reference} was not flown")
        if result is not None:
            flown.append(_flown(result, scheme))
            flown.append(command_box(opened.command("fly", reference=reference), name=f"command-{reference}"))
    return card(
        "In the controller",
        choose,
        *flown,
        note="The mock's vehicle has the effects of the present version. The controller flies the first version's "
        "model, then the present one's: what the controller gains if the effects are real, and not that they are.",
    )


def _flown(flown: VersionsInFlight, scheme: str) -> Any:
    text = (
        f"{flown.reference}: {100 * flown.before.rmse:.1f} cm with the first version in the controller, "
        f"{100 * flown.after.rmse:.1f} cm with the present one (RMS position error)."
    )
    aborted = [run.aborted for run in (flown.before, flown.after) if run.aborted]
    figure = go.Figure()
    everything = np.array([*flown.setpoint, *flown.after.path] or [[0.0] * 3])
    across, up = np.sort(np.argsort(-np.ptp(everything, axis=0))[:2])  # the plane in which the path is widest
    for name, colour, points, width in (
        ("reference", measured_colour(scheme), flown.setpoint, 1.2),
        ("first version", PRESENT, flown.before.path, 1.6),
        ("present version", improved_colour(scheme), flown.after.path, 1.6),
    ):
        path = np.array(points or [[np.nan] * 3])
        figure.add_trace(
            go.Scatter(
                x=path[:, across], y=path[:, up], name=name, mode="lines", line={"color": colour, "width": width}
            )
        )
    figure.update_xaxes(title_text=f"{'xyz'[across]}, m")
    figure.update_yaxes(title_text=f"{'xyz'[up]}, m", scaleanchor="x")
    styled(figure, scheme, height=380)
    return html.Div(
        [
            dmc.Text(text, fw=600, className="flown"),
            *(dmc.Text(f"Ended early: {reason}", c="red") for reason in aborted),
            graph(f"flown-{flown.reference}", figure, f"Paths of {flown.reference}"),
        ]
    )


def _bundle(opened: OpenCase, *, running: bool) -> Any:
    exported, title = opened.result(Exported, "export", shown=False), "A bundle for alula fly"
    if refused := refusal(opened, "export", "Not exported"):
        return card(title, *refused)
    if exported is None:
        return card(title, action("start", "Export the present version", step="export", disabled=running))
    lines = html.Ul([html.Li(line.strip()) for line in exported.summary])
    return card(
        title,
        lines,
        command_box(opened.command("export"), name="export-command"),
        command_box(f"alula fly --bundle {exported.folder} --reference Lemniscate", name="fly-command"),
    )
