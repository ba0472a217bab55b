"""Pictures of flights of the same references before and after: paths, and position error over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from dynamics.arrays import Floats
from studio.pages.colours import AXIS, SPACE_GRID
from studio.pages.figure import AFTER, BEFORE, Picture, line, picture, thinned

MAX_POINTS = 1200  # of a line
OBLIQUE, DISTANCE, THINNEST = 0.25, 1.5, 0.05  # of the view on a path in space, in sizes of the path
REFERENCE = AXIS


@dataclass(frozen=True, eq=False)
class FlownTrack:
    """One flight while it tracked its reference.

    time: (n,) s.
    position, reference: (n, 3) world, m.
    position_rmse, position_max: distance to the reference, m.
    speed_max: m/s.
    px4_rmse: as position_rmse, on PX4's estimate and by it; None where it was not flown to its end.
    """

    time: Floats
    position: Floats
    reference: Floats
    position_rmse: float
    position_max: float
    speed_max: float
    px4_rmse: float | None = None


@dataclass(frozen=True, eq=False)
class FlownComparison:
    """Manoeuvre flown with the model before and after effects were added to it.

    name: of the manoeuvre.
    before, after: the two flights.
    """

    name: str
    before: FlownTrack
    after: FlownTrack


def tracking_bars(flown: Sequence[FlownComparison]) -> Picture:
    """Position RMSE of each manoeuvre, before and after."""
    figure = go.Figure()
    for name, colour, tracks in _sides(flown):
        rmse = [100 * track.position_rmse for track in tracks]
        figure.add_trace(
            go.Bar(
                x=[f.name for f in flown],
                y=rmse,
                name=name,
                marker_color=colour,
                texttemplate="%{y:.1f}",
                hovertemplate="%{x}<br>" + name + ": %{y:.3g} cm<extra></extra>",
            )
        )
    figure.update_layout(barmode="group")
    figure.update_xaxes(title_text="manoeuvre")
    figure.update_yaxes(title_text="position RMSE, cm", rangemode="tozero")
    return picture(figure, 340, "Bars: position RMSE of each manoeuvre before and after.")


def flight_view(flown: FlownComparison) -> Picture:
    """A manoeuvre from above and from the side, and its error over time."""
    figure = make_subplots(rows=3, row_heights=[0.5, 0.25, 0.25], vertical_spacing=0.11)
    _path(figure, flown.before.reference, "reference", REFERENCE, 5)
    for name, colour, (track,) in _sides([flown]):
        _path(figure, track.position, name, colour, 1.4)
        error = 100 * np.linalg.norm(track.position - track.reference, axis=1)
        rows = thinned([error], MAX_POINTS)
        drawn = line(track.time[rows], error[rows], name=name, colour=colour, unit="cm", showlegend=False)
        figure.add_trace(drawn, row=3, col=1)
        figure.add_hline(y=100 * track.position_rmse, line={"color": colour, "dash": "dash", "width": 1}, row=3, col=1)
    figure.update_xaxes(title_text="x (east), m", row=1, col=1)
    figure.update_yaxes(title_text="y (north), m", scaleanchor="x", row=1, col=1)
    figure.update_xaxes(title_text="x (east), m", row=2, col=1)
    figure.update_yaxes(title_text="z (up), m", row=2, col=1)
    figure.update_xaxes(title_text="time, s", row=3, col=1)
    figure.update_yaxes(title_text="error, cm", rangemode="tozero", row=3, col=1)
    return picture(figure, 760, f"{flown.name} from above, from the side, and its position error over time.")


def flight_in_space(flown: FlownComparison) -> Picture:
    """A manoeuvre in three dimensions, to be turned with the pointer."""
    figure = go.Figure()
    figure.add_trace(_curve(flown.before.reference, "reference", REFERENCE, 6))
    for name, colour, (track,) in _sides([flown]):
        figure.add_trace(_curve(track.position, name, colour, 3))
    axes = {f"{axis}axis": {"title": f"{axis}, m", "gridcolor": SPACE_GRID} for axis in "xyz"}
    eye = dict(zip("xyz", best_view(flown.before.reference).tolist(), strict=True))
    paths = np.vstack([flown.before.reference, flown.before.position, flown.after.position])
    sides = dict(zip("xyz", sides_of(paths).tolist(), strict=True))
    scene = {**axes, "aspectmode": "manual", "aspectratio": sides, "camera": {"eye": eye}}
    figure.update_layout(scene=scene)
    return picture(figure, 420, f"{flown.name} in three dimensions.")


def sides_of(position: Floats) -> Floats:
    """(3,) sides of the box around paths (n, 3), true to scale, the longest 1: a flat path then fills the picture."""
    extent = np.ptp(position, axis=0)
    return np.asarray(np.maximum(extent / max(float(extent.max()), 1e-9), THINNEST))


def best_view(position: Floats) -> Floats:
    """(3,) where to stand to see a path (n, 3) in the plane in which it is widest, from above and a little aslant."""
    _, _, (_, shorter, across) = np.linalg.svd(position - position.mean(axis=0), full_matrices=False)
    across, shorter = (axis if axis[2] >= 0 else -axis for axis in (across, shorter))
    # aslant from the path's shorter side, so that the longer one lies across the picture; never along the vertical
    view = across + OBLIQUE * (shorter + np.array([0.0, 0.0, 1.0]))
    return np.asarray(DISTANCE * view / np.linalg.norm(view))


def _sides(flown: Sequence[FlownComparison]) -> tuple[tuple[str, str, list[FlownTrack]], ...]:
    return ("before", BEFORE, [f.before for f in flown]), ("after", AFTER, [f.after for f in flown])


def _path(figure: go.Figure, position: Floats, name: str, colour: str, width: float) -> None:
    """Path from above (x, y) and from the side (x, z)."""
    for row, axis in ((1, 1), (2, 2)):
        rows = thinned([position[:, 0], position[:, axis]], MAX_POINTS)
        drawn = line(
            position[rows, 0],
            position[rows, axis],
            name=name,
            colour=colour,
            unit="m",
            width=width,
            showlegend=row == 1,
            legendgroup=name,
        )
        figure.add_trace(drawn, row=row, col=1)


def _curve(position: Floats, name: str, colour: str, width: float) -> Any:
    rows = thinned([*position.T], MAX_POINTS)
    x, y, z = position[rows].astype(np.float32).T
    return go.Scatter3d(x=x, y=y, z=z, name=name, mode="lines", line={"color": colour, "width": width})
