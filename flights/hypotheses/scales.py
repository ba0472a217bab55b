"""Units of motion, by the sizes of signals that must be one: these are the same in all axes and any order."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from flights.agreement import both

# Sizes of a unit beside ours, by the kind of quantity: a value in it is so many times ours.
LENGTHS: Mapping[str, float] = {"mm": 1000.0, "cm": 100.0, "ft": 1 / 0.3048, "in": 1 / 0.0254}
ANGLES: Mapping[str, float] = {"deg": 180 / np.pi, "mrad": 1000.0, "mdeg": 180_000 / np.pi, "rev": 0.5 / np.pi}
FORCES: Mapping[str, float] = {"g": 1 / GRAVITY, "mg": 1000 / GRAVITY, "cm/s^2": 100.0, "mm/s^2": 1000.0}
NEAR = 0.15  # of a unit's size, within which a ratio is that unit
NEAR_GRAVITY = 0.4  # the same of the usual specific force, which brisk flights change
_MIN_ROWS = 20  # from which on there is a usual size
SAME = 0.25  # of 1, within which a ratio is no other unit
MAX_FACTOR = 1.8  # by which noise, a filter or a wrong thrust constant may change a size; beyond, it is a scale


def named(ratio: float, units: Mapping[str, float], near: float = NEAR) -> tuple[str, float] | None:
    """Unit and its exact size of a ratio that should be 1; an empty name for a factor of none; None for our own."""
    if not np.isfinite(ratio) or ratio <= 0.0:
        return None
    for unit, size in units.items():
        if abs(np.log(ratio / size)) < near and abs(np.log(ratio)) > SAME:
            return unit, size
    return None if 1 / MAX_FACTOR < ratio < MAX_FACTOR else ("", ratio)


def of_lengths(one: Floats, other: Floats, smallest: float) -> tuple[float, float] | None:
    """Ratio of the sizes of two signals (n, 3), and how their sizes follow each other, -1 to 1.

    smallest: RMS of the other below which neither tells. None where they cannot be compared.
    """
    pair = both(one, other)
    if pair is None:
        return None
    sizes = [np.linalg.norm(values, axis=1) for values in pair]
    if float(np.sqrt(np.mean(sizes[1] ** 2))) < smallest or not float(np.std(sizes[0])) > 0.0:
        return None
    if not (float(np.std(sizes[1])) > 0.0 and float(np.sum(sizes[0] ** 2)) > 0.0):
        return None
    following = float(np.corrcoef(sizes[0], sizes[1])[0, 1])
    return float(np.sqrt(np.sum(sizes[0] ** 2) / np.sum(sizes[1] ** 2))), following


def usual_force(force: Floats) -> float:
    """Size of the usual vector of the specific force (n, 3), which is gravity's in flight; NaN of too few rows."""
    force = force[np.isfinite(force).all(axis=1)]
    return float(np.linalg.norm(np.median(force, axis=0))) if len(force) >= _MIN_ROWS else float("nan")
