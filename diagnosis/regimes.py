"""Where a model fails: error over noise floor in cells of speed, thrust, rates, height, place, time and voltage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from diagnosis.channels import KINDS
from diagnosis.filters import Floats, kept
from diagnosis.stretch import Stretch
from dynamics.vehicle import Vehicle

BINS = 6
LEAST_ROWS = 25  # of a cell that counts as flown: one second
FAILS = 1.5  # RMS over floor of a cell that is named


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


def regime_maps(
    stretches: Sequence[Stretch], rows: Sequence[Floats], floor: Floats, vehicle: Vehicle
) -> tuple[Regime, ...]:
    """Error over floor of each kind of channel along each quantity. rows: (m, 12) residuals; floor: (12,)."""
    values = [_quantities(s, vehicle) for s in stretches]
    everything = np.vstack(rows)
    return tuple(
        _regime(name, np.concatenate([v[name] for v in values]), everything, floor)
        for name in values[0]
        if all(name in v for v in values)
    )


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


def _regime(name: str, values: Floats, rows: Floats, floor: Floats) -> Regime:
    low, high = np.quantile(values, [0.005, 0.995])
    edges = np.linspace(low, max(high, low + 1e-6), BINS + 1)
    cell = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    result = np.full((len(KINDS), BINS), np.nan)
    for b in range(BINS):
        inside = rows[cell == b]
        if len(inside) < LEAST_ROWS:
            continue
        for k in range(len(KINDS)):
            level = float(np.sum(floor[3 * k : 3 * k + 3] ** 2))
            if level > 0:
                result[k, b] = np.sqrt(np.mean(np.sum(inside[:, 3 * k : 3 * k + 3] ** 2, axis=1)) / level)
    return Regime(name, edges, result)


def _quantities(stretch: Stretch, vehicle: Vehicle) -> dict[str, Floats]:
    rows = kept(len(stretch), stretch.rate)
    velocity, rate = stretch.smooth[rows, 3:6], stretch.smooth[rows, 10:13]
    thrust = (stretch.rotor_speed**2 @ vehicle.rotors.allocation[0])[rows]
    found = {
        "speed m/s": np.linalg.norm(velocity, axis=1),
        "climb m/s": velocity[:, 2],
        "heading of motion rad": np.arctan2(velocity[:, 1], velocity[:, 0]),
        "thrust over weight": thrust / vehicle.weight,
        "body rate rad/s": np.linalg.norm(rate, axis=1),
        "yaw rate rad/s": rate[:, 2],
        "height m": stretch.position[rows, 2],
        "east m": stretch.position[rows, 0],
        "north m": stretch.position[rows, 1],
        "time s": stretch.start + np.arange(len(stretch))[rows] / stretch.rate,
    }
    if stretch.battery_ratio is not None:
        found["battery voltage over full"] = stretch.battery_ratio[rows]
    return found
