"""Leftovers beside the named effects, for people: in which channel, how large, when and in which regime."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.likelihood.features import Line, time_of
from diagnosis.likelihood.left_over import Left
from diagnosis.models import channels
from diagnosis.regimes import regime_maps, worst_cells
from diagnosis.report import Leftover, Seconds
from diagnosis.thresholds import DEFAULT, RegimeThresholds, Thresholds
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

TESTS: Mapping[str, str] = {
    "state": "predictable_from_state",
    "velocity": "predictable_from_state",
    "place": "position_dependent",
    "time": "predictable_from_time",
    "line": "spectral_line",
}


def leftover(
    left: Sequence[Left], segments: Sequence[Segment], floor: Floats, vehicle: Vehicle, thresholds: Thresholds = DEFAULT
) -> tuple[Leftover, ...]:
    """Leftovers, the surest first. segments: that were fitted. floor: (12,) of the channels."""
    entries = []
    for one in left:
        channel, rms = _channel(one, segments[0]), one.rms
        parts = [_course(one, segment) for segment in segments]
        rows, own_floor = _alone(parts, channel, rms)
        maps = regime_maps(segments, rows, own_floor, vehicle, thresholds.regimes)
        kind, of = channels.KINDS[channel // channels.AXES], one.discrepancy.of
        entries.append(
            Leftover(
                test=TESTS[of.kind],
                channel=f"{kind} {'xyz'[channel % channels.AXES]}",
                size=one.log_odds,
                threshold=thresholds.likelihood.named,
                rms=rms,
                over_floor=rms / float(floor[channel]) if floor[channel] > 0 else 0.0,
                unit=channels.UNITS[kind],
                frequency=of.frequency if isinstance(of, Line) else None,
                seconds=_worst_seconds(parts, float(floor[channel]), segments, thresholds.regimes),
                regimes=worst_cells(maps, thresholds.regimes, count=thresholds.regimes.leftover_cells),
            )
        )
    return tuple(entries)


def _channel(one: Left, segment: Segment) -> int:
    """The place among the twelve channels in which a log shows it."""
    if one.channel >= channels.AXES:
        return channels.ANGULAR_ACCELERATION.start + one.channel - channels.AXES
    shown = channels.POSE_ACCELERATION if segment.specific_force is None else channels.SPECIFIC_FORCE
    return shown.start + one.channel


def _course(one: Left, segment: Segment) -> Floats:
    """(m,) of it in a segment's reduced rows, zero where it is not."""
    here = [i for i, rows in enumerate(one.rows) if rows.segment.flight == segment.flight]
    if not here:
        return np.zeros(len(segment.decimated_times))
    times, values = np.concatenate([time_of(one.rows[i]) for i in here]), np.concatenate([one.parts[i] for i in here])
    order = np.argsort(times)
    return np.asarray(np.interp(segment.decimated_times, times[order], values[order]))


def _alone(parts: Sequence[Floats], channel: int, rms: float) -> tuple[list[Floats], Floats]:
    """Its course as residuals (m, 12) of each segment, and a floor (12,) over which its RMS is 1."""
    rows = []
    for part in parts:
        row = np.zeros((len(part), channels.CHANNELS))
        row[:, channel] = part
        rows.append(row)
    floor = np.zeros(channels.CHANNELS)
    floor[channel] = max(rms, 1e-12)
    return rows, floor


def _worst_seconds(
    parts: Sequence[Floats], floor: float, segments: Sequence[Segment], thresholds: RegimeThresholds
) -> tuple[Seconds, ...]:
    """The windows where it is largest, none within another."""
    windows = []
    for part, segment in zip(parts, segments, strict=True):
        count, times = max(1, round(thresholds.worst_window * segment.decimated_rate)), segment.decimated_times
        for place in range(0, max(1, len(part) - count // 2), count):
            level = float(np.sqrt(np.mean(part[place : place + count] ** 2))) / (floor or np.inf)
            start = float(times[place])
            windows.append(Seconds(segment.flight, round(start, 2), round(start + thresholds.worst_window, 2), level))
    return tuple(sorted(windows, key=lambda window: -window.over_floor)[: thresholds.leftover_cells])
