"""Excitation: how much a flight moves, axis by axis, and which regimes it visits."""

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
LOW = 0.5  # m above the ground, where ground effect may act
SPEED_EDGES = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 9.0, 15.0)  # m/s
EFFORT_EDGES = (0.0, 0.4, 0.7, 0.9, 1.1, 1.3, 1.6, 2.0, 4.0)  # of the usual thrust
RATE_EDGES = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # rad/s


class Measure(msgspec.Struct, frozen=True):
    """One measure of excitation; root mean square over the free flight if `measures` gives no other definition."""

    name: str
    value: float
    unit: str


class Coverage(msgspec.Struct, frozen=True):
    """Seconds spent in the cells of a map.

    row_name, column_name: with units.
    row_edges, column_edges: of the cells.
    seconds: by row and column.
    """

    row_name: str
    column_name: str
    row_edges: tuple[float, ...]
    column_edges: tuple[float, ...]
    seconds: tuple[tuple[float, ...], ...]


def measures(segments: Sequence[Flight], *, ground: float = 0.0) -> dict[str, float]:
    """Every measure of the segments of free flight; see `MEASURES` for names and units.

    ground: its height, m.

    speed is the 95th percentile, headings the spread of the yaw angle, voltage_drop the range over the mean,
    low_flight the seconds near the ground.
    """
    if not segments:
        return {"duration": 0.0}
    excitation = {"duration": sum(segment.duration for segment in segments)}
    parts = [_segment_signals(segment) for segment in segments]
    signals = _joined_signals(parts)
    excitation |= {name: _rms(values) for name, values in signals.items() if name in MEASURES}
    if "speed" in signals:
        excitation["speed"] = float(np.nanpercentile(signals["speed"], 95))
    if "height" in signals:
        excitation["low_flight"] = float(np.sum(signals["height"] < ground + LOW) * segments[0].period)
    if "yaw" in signals:
        concentration = float(np.abs(np.nanmean(np.exp(1j * signals["yaw"]))))
        excitation["headings"] = float(np.sqrt(-2 * np.log(np.clip(concentration, 1e-9, 1.0))))  # circular std
    if "voltage" in signals:
        voltage = signals["voltage"][np.isfinite(signals["voltage"])]
        low, high = np.percentile(voltage, [2, 98])
        excitation["voltage_drop"] = float((high - low) / max(float(np.mean(voltage)), 1e-9))
    if "effort" in signals:
        excitation["thrust_range"] = float(np.nanstd(signals["effort"]))
    return excitation


def coverages(segments: Sequence[Flight]) -> tuple[Coverage, ...]:
    """Where the time was spent: speed and thrust, speed and body rates."""
    if not segments:
        return ()
    signals = _joined_signals([_segment_signals(segment) for segment in segments])
    period = segments[0].period
    if "speed" not in signals:
        return ()
    return tuple(
        _map("speed m/s", signals["speed"], SPEED_EDGES, heading, signals[name], edges, period)
        for heading, name, edges in (("thrust 1", "effort", EFFORT_EDGES), ("rate rad/s", "turning", RATE_EDGES))
        if name in signals
    )


def _joined_signals(parts: Sequence[dict[str, Floats]]) -> dict[str, Floats]:
    """The signals that all segments have, concatenated, without those that are never finite."""
    names = [name for name in parts[0] if all(name in part for part in parts)]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in names}
    return {name: values for name, values in joined.items() if np.isfinite(values).any()}


def _map(
    row: str,
    rows: Floats,
    row_edges: tuple[float, ...],
    column: str,
    columns: Floats,
    column_edges: tuple[float, ...],
    period: float,
) -> Coverage:
    finite = np.isfinite(rows) & np.isfinite(columns)
    counts, _, _ = np.histogram2d(rows[finite], columns[finite], bins=[np.array(row_edges), np.array(column_edges)])
    seconds = tuple(tuple(round(float(value) * period, 3) for value in line) for line in counts)
    return Coverage(row, column, row_edges, column_edges, seconds)


def _segment_signals(segment: Flight) -> dict[str, Floats]:
    """Signals of one segment, (n,) each."""
    signals: dict[str, Floats] = {}
    velocity = _velocity(segment)
    if velocity is not None:
        signals["speed"] = np.linalg.norm(velocity, axis=1)
        signals["acceleration"] = np.linalg.norm(_smooth_slope(segment, velocity), axis=1)
    if velocity is not None and segment.has("attitude"):
        body = quaternion.rotate_inverse(segment["attitude"], velocity)
        signals |= {"forward_speed": body[:, 0], "sideways_speed": body[:, 1], "climb_speed": body[:, 2]}
        signals["lateral_speed"] = np.hypot(body[:, 0], body[:, 1])
    if segment.has("attitude"):
        upward = quaternion.rotate(segment["attitude"], np.array([0.0, 0.0, 1.0]))[:, 2]
        signals["tilt"] = np.arccos(np.clip(upward, -1.0, 1.0))
        signals["yaw"] = quaternion.to_euler(segment["attitude"])[..., 2]
    if segment.has("rate"):
        rate, angular_acceleration = segment["rate"], _smooth_slope(segment, segment["rate"])
        for axis, name in enumerate(("roll", "pitch", "yaw")):
            signals[f"{name}_rate"], signals[f"{name}_acceleration"] = rate[:, axis], angular_acceleration[:, axis]
        signals["tilting_rate"] = np.hypot(rate[:, 0], rate[:, 1])
        signals["tilting_acceleration"] = np.hypot(angular_acceleration[:, 0], angular_acceleration[:, 1])
        signals["turning"] = np.linalg.norm(rate, axis=1)
    if segment.has("position"):
        signals["height"] = segment["position"][:, 2]
    if segment.has("battery_voltage"):
        signals["voltage"] = segment["battery_voltage"]
    thrust = effort(segment)
    if thrust is not None:
        signals["effort"] = thrust
    return signals


def _velocity(segment: Flight) -> Floats | None:
    """(n, 3) m/s, world: as logged, else from the position, as the diagnosis takes it; None with neither."""
    if segment.has("velocity"):
        return segment["velocity"]
    return _smooth_slope(segment, segment["position"]) if segment.has("position") else None


def _smooth_slope(segment: Flight, values: Floats) -> Floats:
    cutoff = min(SMOOTHING, 0.4 * segment.rate)
    return filters.derivative(filters.lowpass(values, segment.rate, cutoff, order=2), segment.period)


def _rms(values: Floats) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else 0.0
