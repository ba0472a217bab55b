"""Findings of rejected residual tests: in which channel, how large, when and in which regime."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnosis.data.segment import Segment
from diagnosis.models import channels
from diagnosis.regimes import regime_maps, worst_cells
from diagnosis.report import Leftover, Seconds
from diagnosis.selection.residual_tests import Finding, Rejection, ResidualTests
from diagnosis.thresholds import DEFAULT, RegimeThresholds
from dynamics.arrays import Floats
from dynamics.vehicle import Vehicle

TYPICAL_WINDOW = "typical_window"


def with_typical_window(
    tests: ResidualTests, rows: Sequence[Floats], floor: Floats, among: Sequence[int] = range(channels.CHANNELS)
) -> ResidualTests:
    """The tests with what held-out residuals (m, 12) have beyond their floor (12,), in the channel that has most.

    among: the channels that tell of the model.
    """
    everything = np.vstack(rows)
    there = (floor > 0) & np.isin(np.arange(channels.CHANNELS), among)
    excess = np.zeros(channels.CHANNELS)
    excess[there] = np.mean(everything[:, there] ** 2, axis=0) / floor[there] ** 2 - 1
    channel = int(np.argmax(excess))
    over_floor = float(np.sqrt(max(excess[channel], 0.0)))
    part = tuple(r[:, channel] for r in rows)
    finding = Finding(TYPICAL_WINDOW, channel, over_floor * float(floor[channel]), over_floor, part)
    return replace(tests, findings={**tests.findings, TYPICAL_WINDOW: finding})


def leftover(
    rejections: Sequence[Rejection],
    tests: ResidualTests,
    fitted: Sequence[Segment],
    held_out: Sequence[Segment],
    vehicle: Vehicle,
    thresholds: RegimeThresholds = DEFAULT.regimes,
) -> tuple[Leftover, ...]:
    """Findings of the tests that rejected, the largest over its floor first.

    fitted, held_out: the segments that were tested; a typical window is of the latter.
    """
    entries = []
    for rejection in rejections:
        finding = tests.findings[rejection.test]
        segments = held_out if rejection.test == TYPICAL_WINDOW else fitted
        kind = channels.KINDS[finding.channel // channels.AXES]
        rows, floor = _alone(finding)
        maps = regime_maps(segments, rows, floor, vehicle, thresholds)
        entries.append(
            Leftover(
                test=rejection.test,
                channel=f"{kind} {'xyz'[finding.channel % channels.AXES]}",
                size=rejection.size,
                threshold=rejection.threshold,
                rms=finding.rms,
                over_floor=finding.over_floor,
                unit=channels.UNITS[kind],
                frequency=finding.frequency,
                seconds=_worst_seconds(finding, segments, thresholds),
                regimes=worst_cells(maps, thresholds, count=thresholds.leftover_cells),
            )
        )
    return tuple(sorted(entries, key=lambda one: -one.over_floor))


def _alone(finding: Finding) -> tuple[list[Floats], Floats]:
    """The part that a test found as residuals (m, 12) of each segment, and a floor (12,) over which its RMS is 1."""
    rows = []
    for part in finding.part:
        row = np.zeros((len(part), channels.CHANNELS))
        row[:, finding.channel] = part
        rows.append(row)
    floor = np.zeros(channels.CHANNELS)
    floor[finding.channel] = max(float(np.sqrt(np.mean(np.concatenate(finding.part) ** 2))), 1e-12)
    return rows, floor


def _worst_seconds(finding: Finding, segments: Sequence[Segment], thresholds: RegimeThresholds) -> tuple[Seconds, ...]:
    """The windows where the part is largest, none within another."""
    floor = finding.rms / finding.over_floor if finding.over_floor > 0 else np.inf
    windows = []
    for part, segment in zip(finding.part, segments, strict=True):
        count = max(1, round(thresholds.worst_window * segment.decimated_rate))
        for place in range(0, max(1, len(part) - count // 2), count):
            level = float(np.sqrt(np.mean(part[place : place + count] ** 2))) / floor
            start = segment.start + segment.filters.edge + place / segment.decimated_rate
            windows.append(Seconds(segment.flight, round(start, 2), round(start + thresholds.worst_window, 2), level))
    return tuple(sorted(windows, key=lambda window: -window.over_floor)[: thresholds.leftover_cells])
