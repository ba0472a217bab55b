"""How much a flight moves, axis by axis, and which regimes it visits: what decides what it can tell."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.excitation import MEASURES
from flights import filters
from flights.exclusion import effort
from flights.flight import Flight

SMOOTHING = 8.0  # Hz, as in the equation-error regression
LOW = 0.5  # m above the ground, where it may act
SPEED_EDGES = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 9.0, 15.0)  # m/s
EFFORT_EDGES = (0.0, 0.4, 0.7, 0.9, 1.1, 1.3, 1.6, 2.0, 4.0)  # of the usual thrust
RATE_EDGES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # rad/s


class Measure(msgspec.Struct, frozen=True):
    """One measure of excitation: root mean square over the free flight where nothing else is said."""

    name: str
    value: float
    unit: str


class Coverage(msgspec.Struct, frozen=True):
    """Seconds spent in the cells of a map. rows, columns: their edges; row_name, column_name with units."""

    row_name: str
    column_name: str
    row_edges: tuple[float, ...]
    column_edges: tuple[float, ...]
    seconds: tuple[tuple[float, ...], ...]


def measures(pieces: Sequence[Flight], *, ground: float = 0.0) -> dict[str, float]:
    """Every measure that the segments of free flight tell; see `MEASURES` for names and units.

    ground: its height, m. speed: 95th percentile. headings: spread of the yaw angle. voltage_drop: range over the
    mean. low_flight: s spent near the ground.
    """
    if not pieces:
        return {"duration": 0.0}
    found = {"duration": sum(piece.duration for piece in pieces)}
    parts = [_piece(piece) for piece in pieces]
    whole = _known_parts(parts)
    found |= {name: _rms(values) for name, values in whole.items() if name in MEASURES}
    if "speed" in whole:
        found["speed"] = float(np.nanpercentile(whole["speed"], 95))
    if "height" in whole:
        found["low_flight"] = float(np.sum(whole["height"] < ground + LOW) * pieces[0].period)
    if "yaw" in whole:
        together = float(np.abs(np.nanmean(np.exp(1j * whole["yaw"]))))
        found["headings"] = float(np.sqrt(-2 * np.log(np.clip(together, 1e-9, 1.0))))  # circular standard deviation
    if "voltage" in whole:
        known = whole["voltage"][np.isfinite(whole["voltage"])]
        least, most = np.percentile(known, [2, 98])
        found["voltage_drop"] = float((most - least) / max(float(np.mean(known)), 1e-9))
    if "effort" in whole:
        found["thrust_range"] = float(np.nanstd(whole["effort"]))
    return found


def coverages(pieces: Sequence[Flight]) -> tuple[Coverage, ...]:
    """Where the time was spent: speed and thrust, speed and body rates."""
    if not pieces:
        return ()
    whole = _known_parts([_piece(piece) for piece in pieces])
    period = pieces[0].period
    found = []
    if {"speed", "effort"} <= whole.keys():
        found.append(_map("speed m/s", whole["speed"], SPEED_EDGES, "thrust 1", whole["effort"], EFFORT_EDGES, period))
    if {"speed", "turning"} <= whole.keys():
        found.append(_map("speed m/s", whole["speed"], SPEED_EDGES, "rate rad/s", whole["turning"], RATE_EDGES, period))
    return tuple(found)


def _known_parts(parts: Sequence[dict[str, Floats]]) -> dict[str, Floats]:
    """What all segments tell, after each other, without what is never known."""
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0] if all(name in p for p in parts)}
    return {name: values for name, values in whole.items() if np.isfinite(values).any()}


def _map(
    row: str, rows: Floats, row_edges: tuple[float, ...], column: str, columns: Floats,
    column_edges: tuple[float, ...], period: float,
) -> Coverage:  # fmt: skip
    known = np.isfinite(rows) & np.isfinite(columns)
    counts, _, _ = np.histogram2d(rows[known], columns[known], bins=[np.array(row_edges), np.array(column_edges)])
    seconds = tuple(tuple(round(float(value) * period, 3) for value in line) for line in counts)
    return Coverage(row, column, row_edges, column_edges, seconds)


def _piece(piece: Flight) -> dict[str, Floats]:
    """What one segment tells, (n,) each."""
    found: dict[str, Floats] = {}
    if piece.has("velocity"):
        found["speed"] = np.linalg.norm(piece["velocity"], axis=1)
        found["acceleration"] = np.linalg.norm(_smooth_slope(piece, piece["velocity"]), axis=1)
    if piece.has("velocity", "attitude"):
        body = quaternion.rotate_inverse(piece["attitude"], piece["velocity"])
        found |= {"forward_speed": body[:, 0], "sideways_speed": body[:, 1], "climb_speed": body[:, 2]}
        found["lateral_speed"] = np.hypot(body[:, 0], body[:, 1])
    if piece.has("attitude"):
        upward = quaternion.rotate(piece["attitude"], np.array([0.0, 0.0, 1.0]))[:, 2]
        found["tilt"] = np.arccos(np.clip(upward, -1.0, 1.0))
        found["yaw"] = quaternion.to_euler(piece["attitude"])[..., 2]
    if piece.has("rate"):
        rate, turning = piece["rate"], _smooth_slope(piece, piece["rate"])
        for axis, name in enumerate(("roll", "pitch", "yaw")):
            found[f"{name}_rate"], found[f"{name}_acceleration"] = rate[:, axis], turning[:, axis]
        found["tilting_rate"] = np.hypot(rate[:, 0], rate[:, 1])
        found["tilting_acceleration"] = np.hypot(turning[:, 0], turning[:, 1])
        found["turning"] = np.linalg.norm(rate, axis=1)
    if piece.has("position"):
        found["height"] = piece["position"][:, 2]
    if "battery_voltage" in piece.columns:
        found["voltage"] = piece["battery_voltage"]
    pushed = effort(piece)
    if pushed is not None:
        found["effort"] = pushed
    return found


def _smooth_slope(piece: Flight, values: Floats) -> Floats:
    cutoff = min(SMOOTHING, 0.4 * piece.rate)
    return filters.derivative(filters.lowpass(values, piece.rate, cutoff, order=2), piece.period)


def _rms(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
