"""Motion: oscillation of the rate loops, vibration and clipping, what hit what."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dynamics.arrays import Floats
from flights.health.answer import Evidence, Level, Statement
from flights.health.power import level_of
from flights.health.record import Record, Series, spans
from flights.health.rotors import lost_control, tilt, tilt_between
from flights.health.thresholds import (
    CLIPPED,
    IMPACT_FORCE,
    IMPACT_RATE,
    IMPACT_WINDOW,
    LEANING,
    LEANING_FOR,
    LINE_SHARE,
    OSCILLATION,
    UPSET,
    VIBE,
    VIBRATION,
)

AXES = ("roll", "pitch", "yaw")
MIN_LINE = 2.0  # Hz: slower is position and attitude control, or the pilot
WINDOW = 2.5  # s
MIN_RATE = 15.0  # Hz of the gyro's stream, without which no line can be seen
SUDDEN = 0.15  # s between a blow and the loss of control that it makes
FOLLOWS = 0.6  # of the rate's amplitude in the setpoint's: the setpoint swings itself


def oscillation_statements(record: Record) -> Iterator[Statement]:
    """A narrow line in the body rates of one axis."""
    signal = record.values("rate")
    if signal is None:
        return
    time, rate, source = signal
    period = float(np.median(np.diff(time)))
    if not period > 0 or 1 / period < MIN_RATE:
        return
    worst: tuple[float, int, float, float] | None = None
    for axis in range(3):
        for start, stop in record.flights:
            lines = list(_lines(time, rate[:, axis], period, start + 0.5, stop - 0.5))
            for amplitude, at, frequency in _lasting(lines):
                if worst is None or amplitude > worst[0]:
                    worst = amplitude, axis, at, frequency
    if worst is None:
        return
    amplitude, axis, at, frequency = worst
    level = level_of(amplitude, OSCILLATION)
    if level is None:
        return
    commanded = _setpoint_amplitude(record, axis, at, frequency)
    shown = f"the {AXES[axis]} rate swings at {frequency:.1f} Hz with {amplitude:.1f} rad/s around {at:.1f} s"
    evidence = Evidence(at, at + WINDOW, f"{source}, {AXES[axis]} rate at {frequency:.1f} Hz", amplitude, "rad/s",
                        OSCILLATION.warning)  # fmt: skip
    gains = "MC_ROLLRATE" if axis == 0 else "MC_PITCHRATE" if axis == 1 else "MC_YAWRATE"
    if commanded is not None and commanded > FOLLOWS * amplitude:
        text = f"{shown}, and its setpoint with {commanded:.1f} rad/s: the attitude loop or what commands it swings"
        yield Statement("oscillation", level, "likely", text, evidence,
                        advice=f"lower {gains.removesuffix('RATE')}_P or the reference's pace")  # fmt: skip
        return
    addition = "" if commanded is None else f", its setpoint with {commanded:.1f} rad/s alone"
    text = f"{shown}{addition}: the rate loop is close to unstable, or something on the vehicle is loose"
    advice = (
        f"lower {gains}_P and _D (ATC_RAT_* in ArduPilot) by a third; look for loose arms and a soft autopilot mount"
    )
    yield Statement("oscillation", level, "likely", text, evidence, advice=advice)


def _lasting(lines: Sequence[tuple[float, float, float, float]]) -> Iterator[tuple[float, float, float]]:
    """Amplitude, time and frequency of lines that two windows without common samples have, or one that is large."""
    for place, (at, amplitude, frequency, share) in enumerate(lines):
        if share < LINE_SHARE:
            continue
        if amplitude > OSCILLATION.fault:
            yield amplitude, at, frequency
        elif place + 2 < len(lines):
            _, other, its_frequency, its_share = lines[place + 2]
            if its_share > LINE_SHARE and abs(its_frequency - frequency) < 0.15 * frequency:
                yield min(amplitude, other), at, frequency


def _lines(
    time: Floats, rate: Floats, period: float, start: float, end: float
) -> Iterator[tuple[float, float, float, float]]:
    """Start, amplitude, frequency and share of the strongest line of each window."""
    count = int(WINDOW / period)
    if end - start < WINDOW:
        return
    even = np.arange(start, end, period)
    finite = np.isfinite(rate)
    if finite.sum() < count:
        return
    values = np.interp(even, time[finite], rate[finite])
    taper = np.hanning(count)
    frequency = np.fft.rfftfreq(count, period)
    for first in range(0, len(even) - count + 1, count // 2):
        part = values[first : first + count]
        part = part - np.polyval(np.polyfit(even[:count] - even[0], part, 1), even[:count] - even[0])
        power = np.abs(np.fft.rfft(taper * part) / taper.sum()) ** 2 * 2  # of a sine: half its amplitude squared
        fast = frequency >= MIN_LINE
        if fast.sum() < 4 or power[fast].sum() <= 0:
            continue
        peak = int(np.argmax(np.where(fast, power, 0.0)))
        near = fast & (np.abs(frequency - frequency[peak]) <= 0.15 * frequency[peak])
        # the window of a line spreads its power over neighbours: their sum over the window's noise bandwidth
        amplitude = float(np.sqrt(2 * power[near].sum() / 1.5))
        yield float(even[first]), amplitude, float(frequency[peak]), float(power[near].sum() / power[fast].sum())


def _setpoint_amplitude(record: Record, axis: int, at: float, frequency: float) -> float | None:
    """Amplitude of the rate setpoint at a frequency in the window that begins at a time; None where it is too slow."""
    signal = record.values("rate_setpoint")
    if signal is None:
        return None
    time, values, _ = signal
    rows = (time >= at) & (time <= at + WINDOW) & np.isfinite(values[:, axis])
    if rows.sum() < 8 or 1 / float(np.median(np.diff(time))) < 2.2 * frequency:
        return None
    part = values[rows, axis] - values[rows, axis].mean()
    taper = np.hanning(len(part))
    turn = np.exp(-2j * np.pi * frequency * time[rows])
    return float(2 * np.abs(np.sum(taper * part * turn)) / taper.sum())


def vibration_statements(record: Record) -> Iterator[Statement]:
    """High-frequency acceleration and samples at the accelerometer's limit."""
    own = record.autopilot
    limit = VIBRATION if own.vibration_of == "PX4" else VIBE
    flown = [series.within(record.start + 0.5, record.end).finite() for series in own.vibration]
    flown = [series for series in flown if len(series.values) >= 2]
    if flown:
        worst = max(flown, key=lambda series: float(np.median(series.values)))
        usual = float(np.median(worst.values))
        level = level_of(usual, limit)
        evidence = Evidence(record.start, record.end, worst.channel, usual, "m/s^2", limit.warning)
        text = f"vibration is {usual:.1f} m/s^2 in the median of the flight"
        if level is None:
            yield Statement("vibration_level", "note", "seen", text, evidence)
        else:
            advice = "balance or exchange the propellers, look for loose screws and motors, mount the autopilot softer"
            yield Statement("vibration", level, "seen", f"{text}, beyond healthy vehicles", evidence, advice=advice)
    for series in own.clipping:
        part = series.within(record.start, record.end).finite()
        if len(part.values) < 2:
            continue
        count = float(part.values[-1] - part.values[0])
        level = level_of(count, CLIPPED)
        if level is not None:
            begins = float(part.time[np.flatnonzero(part.values > part.values[0])[0]])
            text = (
                f"the accelerometer was at its limit in {count:.0f} samples from {begins:.1f} s on: the estimate drifts"
            )
            evidence = Evidence(begins, float(part.time[-1]), part.channel, count, "samples", CLIPPED.warning)
            yield Statement("clipping", level, "seen", text, evidence, advice="reduce vibration, see there")
            return


def raw_vibration(record: Record) -> Statement | None:
    """Scatter of the accelerometer's samples, for logs without the autopilot's own measure of vibration."""
    signal = record.values("specific_force")
    if signal is None or record.autopilot.vibration:
        return None
    time, force, source = signal
    rows = record.airborne(time, 1.0) & np.isfinite(force).all(axis=1)
    if rows.sum() < 50:
        return None
    scatter = float(np.median(np.abs(np.diff(force[rows, 2], n=2))) / 0.6745 / np.sqrt(6.0))
    level = level_of(scatter, VIBRATION)
    if level is None:
        return None
    text = (
        f"successive samples of the accelerometer scatter by {scatter:.1f} m/s^2 in flight, as strong vibration makes "
        "them; the autopilot's own measure is not in this log"
    )
    evidence = Evidence(
        record.start, record.end, f"{source}, scatter along body z", scatter, "m/s^2", VIBRATION.warning
    )
    advice = "balance or exchange the propellers, look for loose screws and motors, mount the autopilot softer"
    return Statement("vibration", level, "likely", text, evidence, advice=advice)


def upset_statement(record: Record) -> Statement | None:
    """The attitude that left its setpoint in the air."""
    lost, attitude = lost_control(record), record.values("attitude")
    if lost is None or attitude is None:
        return None
    time, values, source = attitude
    rows = (time >= lost[0]) & (time <= max(lost[1], lost[0] + 0.5))
    setpoint = record.values("attitude_setpoint")
    angle = tilt(values[rows])
    shown = f"the vehicle tilts up to {np.degrees(np.nanmax(angle)):.0f} degrees"
    value = float(np.nanmax(angle))
    if setpoint is not None:
        own = setpoint[1][np.clip(np.searchsorted(setpoint[0], time[rows], side="right") - 1, 0, None)]
        value = float(np.nanmax(tilt_between(values[rows], own)))
        shown = f"the attitude is up to {np.degrees(value):.0f} degrees off its setpoint"
    text = f"control was lost at {lost[0]:.1f} s: {shown}"
    evidence = Evidence(lost[0], lost[1], source, value, "rad", UPSET)
    return Statement("lost_control", "fault", "seen", text, evidence)


def leaning_statement(record: Record) -> Statement | None:
    """A vehicle that lies tilted on something with its rotors turning."""
    signal, attitude = record.values("specific_force"), record.values("attitude")
    if signal is None or attitude is None:
        return None
    time, force, source = signal
    width = max(1, round(0.5 / max(float(np.median(np.diff(time))), 1e-3)))
    if len(time) < 2 * width:
        return None
    mean = np.stack([np.convolve(np.nan_to_num(force[:, k]), np.ones(width) / width, mode="same") for k in (0, 1)])
    across = np.linalg.norm(mean, axis=0)
    angles = np.interp(time, attitude[0], np.nan_to_num(tilt(attitude[1])))
    rests = np.abs(across - 9.81 * np.sin(angles)) < 0.4 * across  # gravity alone, seen from a tilted body
    times = spans(time, (across > LEANING) & rests & record.airborne(time), LEANING_FOR)
    if not times:
        return None
    start, end = times[0]
    rows = (time >= start) & (time <= end)
    angle = float(np.degrees(np.nanmax(tilt(attitude[1])[(attitude[0] >= start) & (attitude[0] <= end)], initial=0.0)))
    text = (
        f"the vehicle lay tilted by up to {angle:.0f} degrees from {start:.1f} to {end:.1f} s with its motors armed: "
        "it tipped over on the ground"
    )
    evidence = Evidence(start, end, f"{source}, across the body", float(across[rows].max()), "m/s^2", LEANING)
    advice = "stop the motors at once after such a landing; look at propellers and motors before the next flight"
    return Statement("tipped_over", "fault", "seen", text, evidence, advice=advice)


def impacts(record: Record) -> tuple[tuple[float, str, float], ...]:
    """Time, channel and size of each blow in the air: a step of body rates or a peak of specific force."""
    peaks: list[tuple[float, str, float]] = []
    rate, force = record.values("rate"), record.values("specific_force")
    if rate is not None:
        time, values, source = rate
        steps = np.linalg.norm(values[1:] - values[:-1], axis=1)
        near = (np.diff(time) < IMPACT_WINDOW) & (steps > IMPACT_RATE) & record.airborne(time[1:])
        peaks += [(float(t), f"{source}, step of the rates", float(s))
                  for t, s in zip(time[1:][near], steps[near], strict=True)]  # fmt: skip
    if force is not None:
        time, values, source = force
        size = np.linalg.norm(values, axis=1)
        usual = size[record.airborne(time, 0.5)]
        limit = max(IMPACT_FORCE, float(np.nanpercentile(usual, 99)) * 1.5 if len(usual) else 0.0)
        rows = (size > limit) & record.airborne(time)
        peaks += [(float(t), f"{source}, specific force", float(s))
                  for t, s in zip(time[rows], size[rows], strict=True)]  # fmt: skip
    return tuple(sorted(peaks))


def impact_statement(record: Record) -> Statement | None:
    """The first blow in the air, and whether control was lost before or after it; a touch-down is a note."""
    peaks, lost = impacts(record), lost_control(record)
    if not peaks:
        return None
    raised = [blow for blow in peaks if record.clear_of_ground(np.array([blow[0]]))[0]]
    followed = [blow for blow in peaks if lost is not None and blow[0] >= lost[0] - SUDDEN]
    chosen = min((group[0] for group in (raised, followed) if group), default=None)
    at, channel, size = chosen or peaks[0]
    group = [blow for blow in peaks if at <= blow[0] <= at + 0.3]
    force = max((blow for blow in group if "force" in blow[1]), key=lambda blow: blow[2], default=None)
    turn = max((blow for blow in group if "rates" in blow[1]), key=lambda blow: blow[2], default=None)
    height = _height(record, at)
    where = "" if height is None else f" {height:.1f} m above the lowest place"
    parts = ([f"{force[2] / 9.81:.1f} g"] if force else []) + (
        [f"{turn[2]:.0f} rad/s between two samples"] if turn else []
    )
    unit, healthy = ("m/s^2", IMPACT_FORCE) if "force" in channel else ("rad/s", IMPACT_RATE)
    evidence = Evidence(at, at + 0.3, channel, size, unit, healthy)
    if chosen is None:
        text = f"the vehicle touched the ground at {at:.1f} s with {', '.join(parts)}"
        return Statement("touch_down", "note", "likely", text, evidence)
    tilted = _tilt_after(record, at)
    order = (
        "after control was lost" if lost is not None and at > lost[0] + SUDDEN
        else "and control was lost with it" if lost is not None and at > lost[0] - SUDDEN
        else "before control was lost" if lost is not None and lost[0] < at + 3.0
        else f"after which the vehicle tilted by {tilted:.0f} degrees" if tilted > np.degrees(UPSET)
        else "control was kept"
    )  # fmt: skip
    text = f"the vehicle hit something at {at:.1f} s{where} ({', '.join(parts)}), {order}"
    level: Level = "fault" if lost is not None or len(group) > 1 else "warning"
    advice = "look for damage to propellers, arms and motor shafts before the next flight"
    return Statement("impact", level, "seen" if force and turn else "likely", text, evidence, advice=advice)


def _tilt_after(record: Record, at: float) -> float:
    """The largest tilt in the 2 s after a time, degrees; 0 where it is not logged."""
    signal = record.values("attitude")
    if signal is None:
        return 0.0
    rows = (signal[0] >= at) & (signal[0] <= at + 2.0)
    return float(np.degrees(np.nanmax(tilt(signal[1][rows]), initial=0.0)))


def _height(record: Record, at: float) -> float | None:
    signal = record.values("position")
    if signal is None or not np.isfinite(signal[1][:, 2]).any():
        return None
    height = signal[1][:, 2]
    return float(np.interp(at, signal[0], height) - np.nanmin(height))


def ends_in_air(record: Record) -> Statement | None:
    """A log whose last sample is in flight with the rotors turning."""
    signal = record.commands() or record.values("rotor_speed")
    last = max((float(stream.time[-1]) for stream in record.log.streams), default=0.0)
    if (
        signal is None
        or not record.flights
        or record.flights[-1][1] < last - 0.3
        or not np.nanmean(signal[1][-3:]) > 0.1
    ):
        return None
    evidence = Evidence(last, last, signal[2], float(np.nanmean(signal[1][-3:])), "1")
    text = "the log ends in flight with the rotors turning: power was lost, the log was cut, or it was stopped"
    return Statement("ends_in_air", "note", "cannot tell", text, evidence)


def series_of(record: Record, name: str, column: int) -> Series | None:
    """One column of a quantity."""
    signal = record.values(name)
    return None if signal is None else Series(signal[0], signal[1][:, column], signal[2])
