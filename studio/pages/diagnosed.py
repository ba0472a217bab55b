"""The pictures of a diagnosis and of a comparison."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from diagnosis.comparison import AxisError
from diagnosis.diagnose import DiagnosisDetails
from diagnosis.models.channels import AXES, KINDS, NAMES, UNITS
from diagnosis.report import ChannelError, Diagnosis
from diagnosis.spectrum import Spectrum
from studio.pages.evidence import Agreement, Likeness, Overlay, by_kind
from studio.pages.figure import (
    AFTER,
    BEFORE,
    FLOOR,
    GREEN,
    MEASURED,
    ORANGE,
    SKY,
    Choice,
    Picture,
    choosing,
    line,
    picture,
)
from studio.pages.numbers import unit_shown

NAMES_WRAPPED = {kind: name.replace(" ", "<br>") for kind, name in NAMES.items()}
AXIS_NAMES = "xyz"
HEADROOM = 1.15  # axis range over the longest bar, for the number behind it


def channel_bars(errors: dict[str, ChannelError]) -> Picture:
    """Error of each kind of channel before and after, in units of its noise floor."""
    figure = go.Figure()
    names = [NAMES_WRAPPED[kind] for kind in errors]
    for label, colour, values in (
        ("current model", BEFORE, [e.before for e in errors.values()]),
        ("improved model", AFTER, [e.after for e in errors.values()]),
    ):
        over = [value / e.floor for value, e in zip(values, errors.values(), strict=True)]
        labels = [f"{value:.4g} {unit_shown(e.unit)}" for value, e in zip(values, errors.values(), strict=True)]
        figure.add_trace(
            go.Bar(
                y=names,
                x=over,
                name=label,
                orientation="h",
                marker_color=colour,
                customdata=labels,
                texttemplate="%{x:.2f}",
                textposition="outside",
                cliponaxis=False,
                hovertemplate="%{y}<br>" + label + ": %{customdata}, %{x:.3g} times the floor<extra></extra>",
            )
        )
    figure.add_vline(x=1, line={"color": FLOOR, "dash": "dash"})
    worst = max(max(e.before, e.after) / e.floor for e in errors.values())
    figure.update_layout(barmode="group")
    figure.update_xaxes(title_text="times the noise floor", range=[0, HEADROOM * worst])
    figure.update_yaxes(automargin=True, autorange="reversed")
    return picture(figure, 120 + 75 * len(names), "Bars: error of each channel before and after, over its noise floor.")


def axis_bars(axes: Sequence[AxisError]) -> Picture:
    """Error of each channel in units of its noise floor."""
    names = [f"{a.kind} {a.axis}" for a in axes]
    figure = go.Figure(
        go.Bar(
            y=names,
            x=[a.rms / a.floor for a in axes],
            orientation="h",
            marker_color=BEFORE,
            texttemplate="%{x:.2f}",
            textposition="outside",
            cliponaxis=False,
            customdata=[f"{a.rms:.4g} {unit_shown(a.unit)}" for a in axes],
            hovertemplate="%{y}<br>%{customdata}, %{x:.3g} times the floor<extra></extra>",
        )
    )
    figure.add_vline(x=1, line={"color": FLOOR, "dash": "dash"})
    figure.update_xaxes(title_text="times the noise floor", range=[0, HEADROOM * max(a.rms / a.floor for a in axes)])
    figure.update_yaxes(automargin=True, autorange="reversed")
    return picture(figure, 90 + 30 * len(names), "Bars: error of each channel over its noise floor.")


def overlay_lines(view: Overlay, *, improved: bool) -> Picture:
    """Measured and modelled over time, one channel at a time, with a jump to the two worst seconds.

    improved: whether there is a better model to draw.
    """
    figure, choices = go.Figure(), []
    for channel in np.argsort(-view.worst_over_floor).tolist():
        if not view.worst_over_floor[channel]:
            continue
        kind, unit = KINDS[channel // AXES], unit_shown(UNITS[KINDS[channel // AXES]])
        lines = [
            ("measured", MEASURED, view.measured, 1.8, "solid"),
            ("current model", BEFORE, view.current, 1.3, "solid"),
        ]
        if improved:
            lines.append(("improved model", AFTER, view.improved, 1.3, "dot"))
        first = len(figure.data)
        for name, colour, table, width, dash in lines:
            drawn = line(view.time, table[:, channel], name=name, colour=colour, unit=unit, width=width, dash=dash)
            figure.add_trace(drawn)
        name = f"{NAMES[kind]}, {AXIS_NAMES[channel % AXES]}"
        choices.append(Choice(name, range(first, len(figure.data)), {"yaxis.title.text": f"{name}, {unit}"}))
    choosing(figure, choices, label="channel")
    for begin, name in zip(view.begins, view.names, strict=True):
        figure.add_vline(x=begin, line={"color": FLOOR, "width": 1})
        figure.add_annotation(
            x=begin, y=1, yref="paper", text=name, showarrow=False, xanchor="left", yanchor="top", font_size=10
        )
    low, high = view.worst
    meta = {
        **figure.layout.meta,
        "jumps": [
            {"name": "worst two seconds", "range": [low - 1, high + 1]},
            {"name": "all", "range": [float(view.time[0]), float(view.time[-1])]},
        ],
    }
    figure.add_vrect(x0=low, x1=high, fillcolor=ORANGE, opacity=0.15, line_width=0)
    figure.update_layout(meta=meta, hovermode="x unified")
    figure.update_xaxes(title_text="time, s (one flight behind the other)", range=[low - 1, high + 1])
    figure.update_yaxes(title_text=choices[0].layout["yaxis.title.text"])
    return picture(figure, 420, "Lines: measurement and models over time.")


def ranking_bars(details: DiagnosisDetails, max_count: int = 14) -> Picture:
    """The log of the odds of each effect beside the named ones, the best first."""
    able = [(one.candidate, one.score) for one in details.tried if one.score is not None][:max_count]
    names = [candidate.key for candidate, _ in able]
    named = {effect.name for effect in details.diagnosis.effects}
    colours = [AFTER if candidate.effect.name in named else SKY for candidate, _ in able]
    min_score = details.noise.thresholds.likelihood.named
    figure = go.Figure(
        go.Bar(
            y=names,
            x=[score for _, score in able],
            orientation="h",
            marker_color=colours,
            customdata=[score for _, score in able],
            hovertemplate="%{y}: score %{customdata:.4g}<extra></extra>",
        )
    )
    figure.add_vline(x=min_score, line={"color": FLOOR, "dash": "dash"})
    figure.update_xaxes(title_text="log of the odds (dashed: minimum for a claim)")
    figure.update_yaxes(automargin=True, autorange="reversed")
    return picture(figure, 110 + 26 * len(names), "Bars: the score of each effect.")


def interval_lines(diagnosis: Diagnosis) -> Picture | None:
    """The fitted parameters with their 95 % intervals, each relative to its value; None where there are none."""
    fitted = [
        (f"{e.name}{'' if e.rotor is None else f'[{e.rotor}]'} {name}", p)
        for e in diagnosis.effects
        for name, p in e.parameters.items()
        if p.std > 0 and p.value
    ]
    if not fitted:
        return None
    reach = [100 * 1.96 * p.std / abs(p.value) for _, p in fitted]
    labels = [f"{p.value:.4g} ± {1.96 * p.std:.2g} {unit_shown(p.unit)}" for _, p in fitted]
    figure = go.Figure(
        go.Scatter(
            y=[name for name, _ in fitted],
            x=[0.0] * len(fitted),
            mode="markers+text",
            text=labels,
            textposition="top center",
            error_x={"type": "data", "array": reach, "thickness": 2},
            marker={"size": 10, "color": AFTER},
            hovertemplate="%{y}: %{text}<extra></extra>",
            cliponaxis=False,
        )
    )
    figure.update_xaxes(title_text="95 % interval, per cent of the value", zeroline=True, zerolinecolor=FLOOR)
    figure.update_yaxes(automargin=True, range=[-0.7, len(fitted) - 0.1])
    return picture(figure, 110 + 60 * len(fitted), "Points with bars: parameters and their 95 % intervals.")


def spectrum_lines(before: Spectrum, after: Spectrum | None) -> Picture:
    """Spectrum of each kind's residual, summed over its axes, against the noise model."""
    models = [("noise model", FLOOR, before.noise, "dash"), ("current model", BEFORE, before.power, "solid")]
    if after is not None:
        models.append(("improved model", AFTER, after.power, "solid"))
    there = [k for k in range(len(KINDS)) if np.isfinite(by_kind(before.power)[k]).all()]
    titles = [NAMES[KINDS[k]] for k in there]
    figure = make_subplots(rows=len(there), shared_xaxes=True, subplot_titles=titles, vertical_spacing=0.08)
    for row, kind in enumerate(there, start=1):
        unit = f"({unit_shown(UNITS[KINDS[kind]])})²/Hz"
        for name, colour, power, dash in models:
            values = by_kind(power)[kind]
            drawn = line(
                before.frequency[1:],
                values[1:],
                name=name,
                colour=colour,
                unit=unit,
                dash=dash,
                showlegend=row == 1,
                legendgroup=name,
            )
            figure.add_trace(drawn, row=row, col=1)
        figure.update_yaxes(title_text=unit, type="log", exponentformat="power", row=row, col=1)
    figure.update_annotations(font_size=12)
    figure.update_xaxes(title_text="frequency, Hz", row=len(there), col=1)
    description = "Lines: power of the models' residuals and of the noise model."
    return picture(figure, 120 + 175 * len(there), description, titles=True)


def agreement_points(agreement: Agreement) -> Picture:
    """Residuals of the accelerometer against those of the pose: a force lies on the diagonal."""
    titles = [f"{AXIS_NAMES[axis]}: {agreement.correlation[axis]:.2f}" for axis in range(3)]
    figure = make_subplots(cols=3, subplot_titles=titles, horizontal_spacing=0.09)
    reach = float(np.quantile(np.abs(np.hstack([agreement.specific_force, agreement.pose_acceleration])), 0.999))
    for axis, colour in enumerate((AFTER, ORANGE, GREEN)):
        figure.add_trace(
            go.Scattergl(
                x=agreement.specific_force[:, axis].astype(np.float32),
                y=agreement.pose_acceleration[:, axis].astype(np.float32),
                mode="markers",
                marker={"size": 4, "color": colour, "opacity": 0.4},
                showlegend=False,
                name=AXIS_NAMES[axis],
                hovertemplate="accelerometer %{x:.3g}, pose %{y:.3g} m/s²<extra></extra>",
            ),
            row=1,
            col=axis + 1,
        )
        diagonal = line(
            np.array([-reach, reach]),
            np.array([-reach, reach]),
            name="a force",
            colour=FLOOR,
            unit="m/s²",
            dash="dash",
            showlegend=False,
        )
        figure.add_trace(diagonal, row=1, col=axis + 1)
        figure.update_xaxes(range=[-reach, reach], nticks=5, row=1, col=axis + 1)
        figure.update_yaxes(range=[-reach, reach], nticks=5, row=1, col=axis + 1)
    figure.update_xaxes(title_text="residual of the accelerometer, m/s²", row=1, col=2)
    figure.update_yaxes(title_text="residual of the pose, m/s²", row=1, col=1)
    figure.update_annotations(font_size=12)
    description = "Points: residuals of accelerometer and pose, axis by axis."
    return picture(figure, 340, description, titles=True)


def likeness_map(likeness: Likeness) -> Picture:
    """Shares of signal that effects have in common on these flights."""
    figure = go.Figure(
        go.Heatmap(
            z=likeness.shared,
            x=likeness.names,
            y=likeness.names,
            zmin=0,
            zmax=1,
            colorscale="Cividis",
            text=[[f"{100 * value:.0f}" for value in row] for row in likeness.shared],
            texttemplate="%{text}",
            textfont_size=10,
            colorbar={"title": "shared", "tickformat": ".0%", "thickness": 12},
            hovertemplate="%{y} and %{x} share %{z:.1%}<extra></extra>",
        )
    )
    figure.update_xaxes(tickangle=-60, automargin=True)
    figure.update_yaxes(automargin=True, autorange="reversed")
    return picture(figure, 520, "Map: share of its signal that each effect has in common with each other.")
