"""Where a model fails: error over noise floor in cells of speed, thrust, rates, height, place, time and voltage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from diagnosis.data.filters import kept
from diagnosis.data.segment import Segment
from diagnosis.models.channels import KINDS
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

BINS = 6
MIN_ROWS = 25  # of a cell that counts as flown: one second
FAILS = 1.5  # RMS over floor of a cell that is named
TRAVELS = 0.3  # m/s, below which motion has no direction
PLANES = (("speed m/s", "thrust over weight"), ("roll rate rad/s", "pitch rate rad/s"), ("east m", "north m"))


class Failure(msgspec.Struct, frozen=True):
    """A cell in which the model fails: where a quantity lies between low and high, in the unit that regime names."""

    regime: str
    low: float
    high: float
    channel: str
    rms_over_floor: float


@dataclass(frozen=True, eq=False)
class Regime:
    """One quantity along the flights. name: with its unit. edges: (b + 1,). over_floor: (4, b), NaN where not flown."""

    name: str
    edges: Floats
    over_floor: Floats


@dataclass(frozen=True, eq=False)
class Plane:
    """Two quantities at once. across, up: with their units. across_edges: (b + 1,). up_edges: (c + 1,).

    over_floor: (4, c, b), NaN where not flown.
    """

    across: str
    up: str
    across_edges: Floats
    up_edges: Floats
    over_floor: Floats


class RegimeCells(msgspec.Struct, frozen=True):
    """A `Regime` as JSON holds it: over_floor of each kind of channel, null where not flown."""

    name: str
    edges: list[float]
    over_floor: dict[str, list[float | None]]


class PlaneCells(msgspec.Struct, frozen=True):
    """A `Plane` as JSON holds it: over_floor of each kind of channel, a row for each cell of `up`."""

    across: str
    up: str
    across_edges: list[float]
    up_edges: list[float]
    over_floor: dict[str, list[list[float | None]]]


def regime_maps(
    segments: Sequence[Segment], rows: Sequence[Floats], floor: Floats, vehicle: Vehicle
) -> tuple[Regime, ...]:
    """Error over floor of each kind of channel along each quantity. rows: (m, 12) residuals; floor: (12,)."""
    squares = _over_floor(rows, floor)
    return tuple(
        Regime(name, edges, _cells(squares, place, len(edges) - 1))
        for name, values in _common(segments, vehicle).items()
        for edges, place in [_placed(values)]
    )


def regime_planes(
    segments: Sequence[Segment], rows: Sequence[Floats], floor: Floats, vehicle: Vehicle
) -> tuple[Plane, ...]:
    """The same over two quantities at once: speed and thrust, roll and pitch rate, place."""
    squares, values = _over_floor(rows, floor), _common(segments, vehicle)
    planes = []
    for across, up in PLANES:
        if across not in values or up not in values:
            continue
        (across_edges, column), (up_edges, row) = _placed(values[across]), _placed(values[up])
        place = np.where((column < 0) | (row < 0), -1, row * BINS + column)
        cells = _cells(squares, place, BINS * BINS).reshape(len(KINDS), BINS, BINS)
        planes.append(Plane(across, up, across_edges, up_edges, cells))
    return tuple(planes)


def regime_cells(regime: Regime) -> RegimeCells:
    """A regime as JSON holds it, of the channels that there are."""
    return RegimeCells(regime.name, regime.edges.tolist(), _by_kind(regime.over_floor))


def plane_cells(plane: Plane) -> PlaneCells:
    """A plane as JSON holds it, of the channels that there are."""
    edges = plane.across_edges.tolist(), plane.up_edges.tolist()
    return PlaneCells(plane.across, plane.up, *edges, _by_kind(plane.over_floor))


def worst_cells(maps: Sequence[Regime], *, count: int = 5) -> tuple[Failure, ...]:
    """The cells that stand out most, at most one of each regime and channel, worst first."""
    found = []
    for regime in maps:
        for kind, cells in zip(KINDS, regime.over_floor, strict=True):
            flown = np.isfinite(cells)
            if np.count_nonzero(flown) < 2:
                continue
            place = int(np.nanargmax(cells))
            worst, usual = float(cells[place]), float(np.nanmedian(cells))
            if worst > FAILS and worst > 1.2 * usual:
                low, high = float(regime.edges[place]), float(regime.edges[place + 1])
                found.append(Failure(regime.name, round(low, 3), round(high, 3), kind, round(worst, 2)))
    return tuple(sorted(found, key=lambda f: -f.rms_over_floor)[:count])


def _over_floor(rows: Sequence[Floats], floor: Floats) -> Floats:
    """(m, 4) squared norm of each kind of channel over that of its floor, NaN for kinds that are absent."""
    everything = np.vstack(rows)
    squares = np.add.reduceat(everything**2, np.arange(0, 3 * len(KINDS), 3), axis=1)
    levels = np.add.reduceat(floor**2, np.arange(0, 3 * len(KINDS), 3))
    return np.asarray(squares / np.where(levels > 0, levels, np.nan))


def _common(segments: Sequence[Segment], vehicle: Vehicle) -> dict[str, Floats]:
    """The quantities that all segments have, (m,) over all of them."""
    values = [_quantities(s, vehicle) for s in segments]
    return {name: np.concatenate([v[name] for v in values]) for name in values[0] if all(name in v for v in values)}


def _placed(values: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Edges of the cells (b + 1,) and the cell of each value, -1 where it is not known."""
    known = np.isfinite(values)
    low, high = np.quantile(values[known], [0.005, 0.995]) if known.any() else (0.0, 0.0)
    edges = np.linspace(low, max(high, low + 1e-6), BINS + 1)
    cell = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    return edges, np.where(known, cell, -1)


def _cells(squares: Floats, place: NDArray[np.intp], count: int) -> Floats:
    """(4, count) RMS over floor in each cell, NaN where less than a second was flown. squares: (m, 4)."""
    result = np.full((len(KINDS), count), np.nan)
    for cell in range(count):
        inside = squares[place == cell]
        if len(inside) >= MIN_ROWS:
            result[:, cell] = np.sqrt(np.mean(inside, axis=0))
    return result


def _by_kind(over_floor: Floats) -> dict[str, list[Any]]:
    """Cells of each kind that there is, rounded, None where not flown."""
    found = zip(KINDS, over_floor, strict=True)
    return {kind: _rounded(cells) for kind, cells in found if np.isfinite(cells).any()}


def _rounded(cells: Floats) -> list[Any]:
    if cells.ndim > 1:
        return [_rounded(row) for row in cells]
    return [round(float(cell), 3) if np.isfinite(cell) else None for cell in cells]


def _quantities(segment: Segment, vehicle: Vehicle) -> dict[str, Floats]:
    """(m,) each, by name; without those that rest on what was not logged."""
    rows = kept(len(segment), segment.rate)
    thrust = (segment.rotor_speed**2 @ vehicle.rotors.allocation[0])[rows]
    rate = segment.smooth[rows, 10:13]
    found = {} if "velocity" in segment.lacks else _motion(segment.smooth[rows, 3:6])
    found |= {
        "thrust over weight": thrust / vehicle.weight,
        "body rate rad/s": np.linalg.norm(rate, axis=1),
        "roll rate rad/s": rate[:, 0],
        "pitch rate rad/s": rate[:, 1],
        "yaw rate rad/s": rate[:, 2],
    }
    if "position" not in segment.lacks:
        place = segment.position[rows]
        found |= {"height m": place[:, 2], "east m": place[:, 0], "north m": place[:, 1]}
    found["time s"] = segment.start + np.arange(len(segment))[rows] / segment.rate
    if segment.battery_ratio is not None:
        found["battery voltage over full"] = segment.battery_ratio[rows]
    return found


def _motion(velocity: Floats) -> dict[str, Floats]:
    level = np.hypot(velocity[:, 0], velocity[:, 1])
    return {
        "speed m/s": np.linalg.norm(velocity, axis=1),
        "climb m/s": velocity[:, 2],
        "heading of motion rad": np.where(level > TRAVELS, np.arctan2(velocity[:, 1], velocity[:, 0]), np.nan),
    }
