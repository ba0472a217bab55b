"""Where a model fails: error over noise floor in cells of speed, thrust, rates, height, place, time and voltage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from diagnosis.data.segment import Segment
from diagnosis.models.channels import KINDS, squared_by_kind
from diagnosis.thresholds import DEFAULT, RegimeThresholds
from dynamics.arrays import Floats
from dynamics.state import RATE, VELOCITY
from dynamics.vehicle import Vehicle

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
    """Error along one quantity.

    name: of the quantity, with its unit.
    edges: (b + 1,) of the cells.
    over_floor: (4, b) RMS of each kind of channel over its noise floor, NaN where not flown.
    rank: (4,) place of the quantity among those that the error depends on: 0 for the one that explains most of each
        kind, then the one that explains most of what is left. What merely moves with a cause comes late.
    """

    name: str
    edges: Floats
    over_floor: Floats
    rank: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Plane:
    """Error over two quantities at once.

    across, up: the quantities, with their units.
    across_edges, up_edges: (b + 1,) and (c + 1,) of the cells.
    over_floor: (4, c, b) RMS of each kind of channel over its noise floor, NaN where not flown.
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
    segments: Sequence[Segment],
    rows: Sequence[Floats],
    floor: Floats,
    vehicle: Vehicle,
    thresholds: RegimeThresholds = DEFAULT.regimes,
) -> tuple[Regime, ...]:
    """Error over floor of each kind of channel along each quantity. rows: (m, 12) residuals; floor: (12,)."""
    squares = _over_floor(rows, floor)
    values = row_quantities(segments, vehicle, thresholds)
    placed = [_placed(one, thresholds) for one in values.values()]
    places = np.array([place for _, place in placed])
    ranks = np.array([causes_first(squares[:, kind], places, thresholds.bins) for kind in range(len(KINDS))]).T
    return tuple(
        Regime(name, edges, _cells(squares, place, len(edges) - 1, thresholds.min_rows), rank)
        for name, (edges, place), rank in zip(values, placed, ranks, strict=True)
    )


def causes_first(squares: Floats, places: NDArray[np.intp], bins: int) -> NDArray[np.intp]:
    """(q,) rank of each quantity by what it explains of squared errors that those before it do not.

    Forward selection of main effects: the means of the cells of the quantity that explains most are taken off, and the
    next one is judged by what is left. Quantities that move together with a cause then explain little.

    squares: (m,); NaN where there is no such channel. places: (q, m) cell of each row in each quantity, -1 for none.
    """
    left, ranks = squares - np.nanmean(squares) if np.isfinite(squares).any() else squares, np.zeros(len(places), int)
    open_ones = list(range(len(places)))
    for rank in range(len(places)):
        means = {q: _cell_means(left, places[q], bins) for q in open_ones}
        best = max(open_ones, key=lambda q: np.nansum(means[q] ** 2))
        ranks[best] = rank
        left = left - means[best]
        open_ones.remove(best)
    return ranks


def _cell_means(values: Floats, place: NDArray[np.intp], bins: int) -> Floats:
    """(m,) mean of the values in each row's cell, 0 for rows without one or without a value."""
    here = (place >= 0) & np.isfinite(values)
    count = np.bincount(place[here], minlength=bins)
    mean = np.bincount(place[here], values[here], minlength=bins) / np.maximum(count, 1)
    return np.where(here, mean[np.maximum(place, 0)], 0.0)


def regime_planes(
    segments: Sequence[Segment],
    rows: Sequence[Floats],
    floor: Floats,
    vehicle: Vehicle,
    thresholds: RegimeThresholds = DEFAULT.regimes,
) -> tuple[Plane, ...]:
    """Errors over two quantities at once: speed and thrust, roll and pitch rate, place."""
    squares, values, bins = _over_floor(rows, floor), row_quantities(segments, vehicle, thresholds), thresholds.bins
    planes = []
    for across, up in PLANES:
        if across not in values or up not in values:
            continue
        across_edges, column = _placed(values[across], thresholds)
        up_edges, row = _placed(values[up], thresholds)
        place = np.where((column < 0) | (row < 0), -1, row * bins + column)
        cells = _cells(squares, place, bins * bins, thresholds.min_rows).reshape(len(KINDS), bins, bins)
        planes.append(Plane(across, up, across_edges, up_edges, cells))
    return tuple(planes)


def regime_cells(regime: Regime) -> RegimeCells:
    """A regime as JSON holds it, of the channels that there are."""
    return RegimeCells(regime.name, regime.edges.tolist(), _by_kind(regime.over_floor))


def plane_cells(plane: Plane) -> PlaneCells:
    """A plane as JSON holds it, of the channels that there are."""
    edges = plane.across_edges.tolist(), plane.up_edges.tolist()
    return PlaneCells(plane.across, plane.up, *edges, _by_kind(plane.over_floor))


def worst_cells(
    maps: Sequence[Regime], thresholds: RegimeThresholds = DEFAULT.regimes, *, count: int = 5
) -> tuple[Failure, ...]:
    """The cells that stand out most, at most one of each regime and channel: causes first, among these the worst."""
    failures = []
    for regime in maps:
        for kind, cells, rank in zip(KINDS, regime.over_floor, regime.rank.tolist(), strict=True):
            if np.count_nonzero(np.isfinite(cells)) < 2:
                continue
            place = int(np.nanargmax(cells))
            worst, usual = float(cells[place]), float(np.nanmedian(cells))
            if worst > thresholds.min_failing and worst > thresholds.min_failing_share * usual:
                low, high = float(regime.edges[place]), float(regime.edges[place + 1])
                failure = Failure(regime.name, round(low, 3), round(high, 3), kind, round(worst, 2))
                failures.append((rank, -worst, failure))
    return tuple(failure for *_, failure in sorted(failures, key=lambda failure: failure[:2])[:count])


def _over_floor(rows: Sequence[Floats], floor: Floats) -> Floats:
    """(m, 4) squared norm of each kind of channel over that of its floor, NaN for kinds that are absent."""
    squares, levels = squared_by_kind(np.vstack(rows)), squared_by_kind(floor)
    return np.asarray(squares / np.where(levels > 0, levels, np.nan))


def row_quantities(segments: Sequence[Segment], vehicle: Vehicle, thresholds: RegimeThresholds) -> dict[str, Floats]:
    """The quantities that all segments have, (m,) over all of them."""
    values = [_quantities(s, vehicle, thresholds) for s in segments]
    return {name: np.concatenate([v[name] for v in values]) for name in values[0] if all(name in v for v in values)}


def _placed(values: Floats, thresholds: RegimeThresholds) -> tuple[Floats, NDArray[np.intp]]:
    """Edges of the cells (b + 1,) and the cell of each value, -1 for NaN."""
    finite, bins = np.isfinite(values), thresholds.bins
    low, high = np.quantile(values[finite], thresholds.quantiles) if finite.any() else (0.0, 0.0)
    edges = np.linspace(low, max(high, low + 1e-6), bins + 1)
    cell = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, bins - 1)
    return edges, np.where(finite, cell, -1)


def _cells(squares: Floats, place: NDArray[np.intp], count: int, min_rows: int) -> Floats:
    """(4, count) RMS over floor in each cell, NaN where fewer rows were flown. squares: (m, 4)."""
    result = np.full((len(KINDS), count), np.nan)
    for cell in range(count):
        inside = squares[place == cell]
        if len(inside) >= min_rows:
            result[:, cell] = np.sqrt(np.mean(inside, axis=0))
    return result


def _by_kind(over_floor: Floats) -> dict[str, list[Any]]:
    """Cells of each kind that there is, rounded, None where not flown."""
    by_kind = zip(KINDS, over_floor, strict=True)
    return {kind: _rounded(cells) for kind, cells in by_kind if np.isfinite(cells).any()}


def _rounded(cells: Floats) -> list[Any]:
    if cells.ndim > 1:
        return [_rounded(row) for row in cells]
    return [round(float(cell), 3) if np.isfinite(cell) else None for cell in cells]


def _quantities(segment: Segment, vehicle: Vehicle, thresholds: RegimeThresholds) -> dict[str, Floats]:
    """(m,) each, by name; without those that need what was not logged."""
    rows = segment.decimated
    thrust = (segment.rotor_speed**2 @ vehicle.rotors.allocation[0])[rows]
    rate = segment.smooth[rows, RATE]
    values = {}
    if "velocity" not in segment.lacks:
        values = _motion(segment.smooth[rows, VELOCITY], thresholds.min_speed)
    values |= {
        "thrust over weight": thrust / vehicle.weight,
        "body rate rad/s": np.linalg.norm(rate, axis=1),
        "roll rate rad/s": rate[:, 0],
        "pitch rate rad/s": rate[:, 1],
        "yaw rate rad/s": rate[:, 2],
    }
    if "position" not in segment.lacks:
        position = segment.position[rows]
        values |= {"height m": position[:, 2], "east m": position[:, 0], "north m": position[:, 1]}
    values["time s"] = segment.start + np.arange(len(segment))[rows] / segment.rate
    if segment.battery_ratio is not None:
        values["battery voltage over full"] = segment.battery_ratio[rows]
    return values


def _motion(velocity: Floats, min_speed: float) -> dict[str, Floats]:
    """Quantities of velocity (m, 3), m/s; the heading is NaN below min_speed, m/s."""
    level = np.hypot(velocity[:, 0], velocity[:, 1])
    return {
        "speed m/s": np.linalg.norm(velocity, axis=1),
        "climb m/s": velocity[:, 2],
        "heading of motion rad": np.where(level > min_speed, np.arctan2(velocity[:, 1], velocity[:, 0]), np.nan),
    }
