"""Checks of each sensor by itself and against the next: a velocity that is no derivative, a range that clips."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.thresholds import DataChecks
from dynamics.arrays import Floats
from dynamics.errors import DataError


def require_velocity(segments: Sequence[Segment], limits: DataChecks) -> None:
    """Raise DataError for a flight whose velocity is not the derivative of its position.

    As a wrong air velocity it would be named a drag, a wind or a gust.
    """
    for flight in dict.fromkeys(s.flight for s in segments):
        own = [s for s in segments if s.flight == flight and not s.lacks & {"position", "velocity"}]
        differences = [_velocity_difference(s, limits.velocity_span) for s in own]
        if not differences:
            continue
        error, speed = (
            _rms(np.vstack(differences)),
            _rms(np.vstack([s.velocity - s.velocity.mean(axis=0) for s in own])),
        )
        estimated = any(s.pose_source == "estimator" for s in own)
        largest = limits.max_estimator_error if estimated else limits.max_velocity_error
        if error > max(largest, limits.max_velocity_share * speed):
            raise DataError(
                f"{Path(flight).name}: velocity and the change of position differ by {error:.2f} m/s RMS at "
                f"{speed:.2f} m/s: they are not of one vehicle, axis or clock, or one is clipped. Check the columns, "
                "or leave the velocity out."
            )


def require_range(segments: Sequence[Segment], limits: DataChecks) -> None:
    """Raise DataError for a gyro, an accelerometer, rotor speeds or commands that stand at their range's end."""
    for flight in dict.fromkeys(s.flight for s in segments):
        own = [s for s in segments if s.flight == flight]
        for name, share, limit in _at_ends(own, limits):
            if share > limit:
                raise DataError(
                    f"{Path(flight).name}: the {name} stands at the end of its range in {100 * share:.0f} % of the "
                    "rows: it is clipped. Set a wider range, or fly more gently."
                )


def _velocity_difference(segment: Segment, span: float) -> Floats:
    """(m, 3) mean velocity by the positions a span, s, apart, less that of the velocities between, m/s."""
    count = max(1, round(span * segment.rate))
    if len(segment) <= count:
        return np.zeros((1, 3))
    travelled = (segment.position[count:] - segment.position[:-count]) * (segment.rate / count)
    passed = np.vstack([np.zeros((1, 3)), np.cumsum((segment.velocity[1:] + segment.velocity[:-1]) / 2, axis=0)])
    return np.asarray(travelled - (passed[count:] - passed[:-count]) / count)


def _at_ends(segments: Sequence[Segment], limits: DataChecks) -> list[tuple[str, float, float]]:
    """(sensor, greatest share of a channel's rows at its extreme, limit of that share)."""
    rotors = "rotor speed" if segments[0].rotor_source == "measured" else "command of the rotors"
    sensors: list[tuple[str, list[Floats], float]] = [
        ("gyro", [s.gyro for s in segments if s.gyro is not None], limits.max_clipped),
        ("accelerometer", [s.specific_force for s in segments if s.specific_force is not None], limits.max_clipped),
        (rotors, [s.rotor_speed for s in segments], limits.max_rotor_clipped),
    ]
    return [(name, _share_at_ends(np.vstack(parts)), limit) for name, parts, limit in sensors if parts]


def _share_at_ends(values: Floats) -> float:
    """Greatest share of rows at a channel's greatest size, over channels that move. values: (n, k)."""
    size = np.abs(values)
    greatest = size.max(axis=0)
    moving = np.ptp(size, axis=0) > 0.0
    at_end = np.mean(size >= greatest * (1 - 1e-9), axis=0)
    return float(np.max(at_end[moving], initial=0.0))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))
