"""Quality of single streams: rate, jitter, gaps, noise, values that stand still, repeat or clip."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from dynamics.arrays import Floats
from flights.alignment import GAP_PERIODS, MIN_GAP
from flights.log import Log, Stream
from flights.quality.findings import Finding
from flights.quantities import MOTION, RESET_COUNTERS, ROTORS

MAX_JITTER = 0.5  # of a period, for 1 in 20 samples
MAX_LOST = 0.02  # share of samples
MIN_STEPS, REGULAR, ON_CLOCK = 20, 0.95, 0.1  # steps to judge by; share of them that lie on a clock within 0.1 periods
STUCK_TIME = 10.0  # s for which a moving quantity may keep a value
STUCK_BATTERY = 20.0  # s of flight in which any battery's reading moves
MAX_REPEATS = 0.4  # share of samples that equal the one before
CLIPPED = 0.01  # share of samples that lie exactly at the extreme
MIN_CLIPPED = 5  # consecutive samples


class Channel(msgspec.Struct, frozen=True):
    """One stream's quality.

    rate: Hz.
    renewed: Hz at which its values change; less than rate where samples are repeated.
    jitter: s by which 1 in 20 periods is off.
    longest_gap: s.
    missing: share of samples with NaN.
    noise: standard deviation of single samples, in unit.
    """

    quantity: str
    source: str
    unit: str
    samples: int
    rate: float
    renewed: float
    jitter: float
    gaps: int
    longest_gap: float
    missing: float
    noise: float


def channels_of(log: Log) -> tuple[Channel, ...]:
    """Every stream that is used, in the order of the flight CSV."""
    return tuple(_channel(stream) for name in log.names if (stream := log.stream(name)) is not None)


def channel_findings(log: Log, flying: Sequence[tuple[float, float]]) -> list[Finding]:
    """Findings about single streams. flying: segments of free flight, s."""
    findings: list[Finding] = []
    for channel in channels_of(log):
        stream = log.stream(channel.quantity)
        if stream is not None and (channel.quantity in MOTION or channel.quantity in ROTORS):
            findings += _timing(channel, lost_samples(stream.time))
    for name in log.names:
        stream = log.stream(name)
        if stream is None or name in RESET_COUNTERS or name in ("armed", "landed") or name.endswith("setpoint"):
            continue
        airborne = _within(stream, flying)
        if len(airborne) > 20:
            findings += _standing_still(stream, airborne)
            findings += _clipping(stream, airborne)
    return findings


def _channel(stream: Stream) -> Channel:
    steps = np.diff(stream.time)
    period = stream.period
    limit = max(GAP_PERIODS * period, MIN_GAP) if len(steps) else np.inf
    held = stream.quantity.kind == "step"
    gaps = steps[steps > limit] if not held else np.empty(0)
    missing = ~np.isfinite(stream.values).all(axis=1)
    return Channel(
        quantity=stream.name,
        source=stream.source,
        unit=stream.unit,
        samples=len(stream.time),
        rate=round(stream.rate, 2),
        renewed=round(stream.rate * (1 - _repeats(stream.values)), 2),
        jitter=float(np.percentile(np.abs(steps - period), 95)) if len(steps) else 0.0,
        gaps=len(gaps),
        longest_gap=float(gaps.max(initial=0.0)),
        missing=float(missing.mean()),
        noise=_noise(stream.values),
    )


def _repeats(values: Floats) -> float:
    if len(values) < 3:
        return 0.0
    return float(np.mean(np.all(values[1:] == values[:-1], axis=1)))


def _noise(values: Floats) -> float:
    """Standard deviation of single samples, from second differences, in which motion is small."""
    second = np.diff(values, n=2, axis=0)
    finite = second[np.isfinite(second).all(axis=1)]
    return float(1.4826 * np.median(np.abs(finite)) / np.sqrt(6)) if len(finite) else 0.0


def lost_samples(time: Floats) -> float:
    """Share of samples that are missing from a regular clock, 0 where it is none. time: (n,) s.

    Steps of whole periods are samples that were lost on the way; others are stamped late.
    """
    steps = np.diff(time)
    if len(steps) < MIN_STEPS:
        return 0.0
    periods = steps / np.median(steps)
    steps_of = np.maximum(np.round(periods), 1)
    if np.mean(np.abs(periods - steps_of) < ON_CLOCK) < REGULAR:
        return 0.0
    return float(1 - len(steps) / np.sum(steps_of[steps_of < GAP_PERIODS]))


def _timing(channel: Channel, lost: float) -> list[Finding]:
    findings = []
    name, where = channel.quantity, f"{channel.quantity} ({channel.source})"
    if channel.gaps:
        findings.append(
            Finding(
                "warning",
                "gaps",
                f"{where} has {channel.gaps} gaps, the longest of {channel.longest_gap:.2f} s",
                "they are masked; a faster card or fewer topics avoids them",
            )
        )
    if lost > MAX_LOST:
        findings.append(
            Finding(
                "warning",
                "lost_samples",
                f"{where}: {lost:.0%} of the samples of {channel.rate:.0f} Hz are missing, the others are on time",
                "a faster card, fewer topics or a better link keeps them",
            )
        )
    elif channel.jitter * channel.rate > MAX_JITTER:
        findings.append(
            Finding(
                "warning",
                "jitter",
                f"{where}: 1 in 20 periods is off by {1e3 * channel.jitter:.1f} ms at {channel.rate:.0f} Hz",
                "use the stamps of the samples, not those of their arrival",
            )
        )
    if channel.renewed < (1 - MAX_REPEATS) * channel.rate and name in MOTION:
        findings.append(
            Finding(
                "warning",
                "repeated_samples",
                f"{where} is logged at {channel.rate:.0f} Hz but changes only {channel.renewed:.0f} times a second",
                "log it when it is measured",
            )
        )
    return findings


def _within(stream: Stream, flying: Sequence[tuple[float, float]]) -> Floats:
    inside = np.zeros(len(stream.time), dtype=bool)
    for start, stop in flying:
        inside |= (stream.time >= start) & (stream.time <= stop)
    return stream.values[inside]


def _standing_still(stream: Stream, values: Floats) -> list[Finding]:
    """Columns that keep one value in flight for longer than a measurement does."""
    battery = stream.name.startswith("battery")
    min_samples = (STUCK_BATTERY if battery else STUCK_TIME) / stream.period
    findings = []
    for name, column in zip(stream.columns, values.T, strict=True):
        finite = column[np.isfinite(column)]
        if len(finite) < min_samples or (stream.quantity.kind == "step" and not battery):
            continue
        steps = np.flatnonzero(np.diff(finite))
        longest = int(np.diff(np.concatenate([[-1], steps, [len(finite) - 1]])).max())
        if longest >= min_samples:
            text = f"{name} stands at {finite[0] if not len(steps) else finite[steps[-1]]:.6g} {stream.unit}"
            findings.append(
                Finding(
                    "warning",
                    "frozen_channel",
                    f"{text} for {longest * stream.period:.0f} s of flight",
                    "it is no measurement there; check its sensor, and leave the column out until it works",
                )
            )
    return findings


def _clipping(stream: Stream, values: Floats) -> list[Finding]:
    """Columns that stay exactly at an extreme value again and again."""
    if stream.name not in (*ROTORS, "rate", "specific_force"):
        return []
    findings = []
    for name, column in zip(stream.columns, values.T, strict=True):
        finite = column[np.isfinite(column)]
        if not len(finite) or np.ptp(finite) == 0.0:
            continue
        for extreme in (finite.max(), finite.min()):
            share = _share_in_runs(finite == extreme)
            if share > CLIPPED and (extreme != 0.0 or stream.name not in ROTORS):
                text = f"{name} stays at {extreme:.6g} {stream.unit} for {share:.1%} of the flight"
                slower = "fly slower or lighter: at its limit a channel has no information about the model"
                wider = "set a wider range of the sensor"
                findings.append(Finding("warning", "saturation", text, slower if stream.name in ROTORS else wider))
    return findings


def _share_in_runs(at_extreme: np.ndarray) -> float:
    """Share of samples in runs of several at the extreme."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at_extreme.astype(np.int8), [0]]))).reshape(-1, 2)
    lengths = edges[:, 1] - edges[:, 0]
    return float(lengths[lengths >= MIN_CLIPPED].sum() / len(at_extreme))
