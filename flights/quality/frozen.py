"""Columns that keep one value in flight for longer than a measurement does: a sensor or a link that stopped."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats
from flights.flight import Flight
from flights.quality.channels import STUCK_TIME
from flights.quality.findings import Finding
from flights.quantities import MOTION

NOISY = ("rate", "specific_force", "rotor_speed")  # sensors whose noise changes every sample
NOISY_TIME = 2.0  # s for which they may keep a value
FRESH_TIME = 0.25  # s for which a column may keep a value that otherwise changes much more often
FRESH_SAMPLES = 5  # samples that this must be at least, of a quantity that is logged slowly
REPEATED_SHARE = 1 / 3  # of that, for which its other values may be repeated, as those that were counted are
WATCHED = (*MOTION, "rotor_speed", "rotor_speed_command", "rotor_command")

ATTITUDE_RESOLUTION = 1e-3  # of a quaternion's component in coarse logs


def frozen_rows(flight: Flight) -> dict[str, NDArray[np.bool_]]:
    """(n,) rows in which a column of motion or rotors keeps one value for so long, by column, if there are any.

    Others of its quantity must change meanwhile. A column that never does counts as well, unless it is zero, as those
    of simulated flights are that stay in a plane. A column that otherwise changes much more often may keep one for much
    shorter, unless that is the largest or smallest that it has, where its range may end, or zero.
    """
    frozen: dict[str, NDArray[np.bool_]] = {}
    moving = _moving(flight)
    for quantity in WATCHED:
        if not flight.has(quantity):
            continue
        columns = flight.columns_of(quantity)
        varying = {name: _varies(values) for name, values in columns.items()}
        for name, values in columns.items():
            if not any(varying.values()) or (not varying[name] and not np.any(np.nan_to_num(values))):
                continue
            seconds = NOISY_TIME if quantity in NOISY else STUCK_TIME
            min_rows = max(2, round(seconds * flight.rate)) if varying[name] else 2
            rows = _constant(values, min_rows)
            others = [other for other in columns if other != name]
            if quantity == "attitude" and _has_unit_length([columns[other][rows] for other in others]):
                continue
            if rows.any() and not any(_varies(columns[other][rows]) for other in others):
                rows = np.zeros(len(values), dtype=bool)
            rows |= _suddenly_constant(values, _fresh_rows(flight, quantity)) & moving
            if rows.any():
                frozen[name] = rows
    return frozen


def _moving(flight: Flight) -> NDArray[np.bool_]:
    """(n,) rows from or to which any column of motion changes."""
    changed = np.zeros(max(0, len(flight) - 1), dtype=bool)
    for name in MOTION:
        if flight.has(name):
            changed |= (np.abs(np.diff(flight[name], axis=0)) > 0.0).any(axis=1)
    return np.asarray(np.concatenate([changed, [False]]) | np.concatenate([[False], changed]))


def _fresh_rows(flight: Flight, quantity: str) -> int:
    """Rows for which a quantity that changes often may keep a value."""
    origin = flight.origins.get(quantity)
    seconds = FRESH_TIME if origin is None else max(FRESH_TIME, FRESH_SAMPLES / origin.rate)
    return max(FRESH_SAMPLES, round(seconds * flight.rate))


def _suddenly_constant(values: Floats, min_rows: int) -> NDArray[np.bool_]:
    """(n,) rows in runs of so many equal values, of a column that has none of a third of that in most of its rows."""
    rows = _constant(values, min_rows)
    if not 0.0 < np.mean(rows) < 0.5 or (_constant(values, math.ceil(REPEATED_SHARE * min_rows) + 1) & ~rows).any():
        return np.zeros(len(values), dtype=bool)
    finite = values[np.isfinite(values)]
    return np.asarray(rows & ~np.isin(values, (0.0, float(np.min(finite)), float(np.max(finite)))))


def frozen_findings(flight: Flight) -> list[Finding]:
    """A finding for each such column."""
    return [
        Finding(
            "warning",
            "frozen_channel",
            f"{name} stands at {flight[name][rows][0]:.6g} {flight.unit(name)} for "
            f"{np.count_nonzero(rows) * flight.period:.1f} s, which are left out",
            "it is no measurement there; check its sensor, and leave the column out until it works",
        )
        for name, rows in frozen_rows(flight).items()
    ]


def _has_unit_length(others: list[Floats]) -> bool:
    """Whether a quaternion's component may stand still by the other ones: near 1 its changes are of second order."""
    component = np.sqrt(np.maximum(1.0 - sum(values**2 for values in others), 0.0))
    return not len(component) or float(np.ptp(component)) < ATTITUDE_RESOLUTION


def _varies(values: Floats) -> bool:
    finite = values[np.isfinite(values)]
    return len(finite) > 1 and float(np.ptp(finite)) > 0.0


def _constant(values: Floats, min_rows: int) -> NDArray[np.bool_]:
    """(n,) rows in runs of equal values of at least so many rows."""
    same = np.concatenate([[0], (np.diff(values) == 0.0).astype(np.int8), [0]])
    rows = np.zeros(len(values), dtype=bool)
    for start, stop in np.flatnonzero(np.diff(same)).reshape(-1, 2).tolist():
        if stop - start + 1 >= min_rows:
            rows[start : stop + 1] = True
    return rows
