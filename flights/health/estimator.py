"""Estimator and receiver: rejected measurements, resets, change of instance, satellites."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flights.health.answer import Evidence, Level, Statement
from flights.health.power import level_of
from flights.health.record import Record, Series, spans
from flights.health.thresholds import (
    GPS_ACCURACY,
    JUMP,
    REJECTED_FOR,
    SWITCH_WINDOW,
    SWITCHES,
    TEST_RATIO,
)

FIX_3D = 3
MIN_LOSS = 1.0  # s without a fix
WHAT = {"velocity": "velocity", "position": "position", "height": "height", "heading": "heading",
        "magnetometer": "the magnetometer"}  # fmt: skip
ADVICE = {
    "velocity": "look at the GPS's or camera's quality at that time",
    "position": "look at the GPS's or camera's quality at that time",
    "height": "look at the barometer (light and prop wash on it) or the height sensor",
    "heading": "calibrate the compass away from metal; look at the heading's source",
    "magnetometer": "move the compass away from power wires and calibrate it, or take the heading from GPS or vision",
}


def rejection_statements(record: Record) -> Iterator[Statement]:
    """Measurements that the estimator rejects in the air."""
    for name in WHAT:
        ratio, flag = record.autopilot.test_ratios.get(name), record.autopilot.rejected.get(name)
        source = next((s for s in (ratio, flag) if s is not None and _times(record, s)), None)
        if source is None:
            continue
        times = _times(record, source)
        longest = max(stop - start for start, stop in times)
        share = sum(stop - start for start, stop in times) / max(record.in_air, 1e-9)
        is_ratio = source is ratio
        level: Level = level_of(longest, REJECTED_FOR) or "warning"
        begins, ends = times[0][0], times[-1][1]
        if name == "magnetometer" and not is_ratio:
            level = "warning"  # single axes; the heading's own test decides whether it matters
        inside = source.within(begins, ends)
        peak = float(np.nanmax(inside.values))
        shown = f"up to {peak:.1f} times their gate" if is_ratio else f"in {100 * share:.0f} % of the flight"
        text = f"the estimator rejects measurements of {WHAT[name]} from {begins:.1f} s on, {shown}"
        evidence = Evidence(begins, ends, source.channel, peak if is_ratio else longest, "1" if is_ratio else "s",
                            TEST_RATIO if is_ratio else REJECTED_FOR.warning)  # fmt: skip
        yield Statement(f"rejects_{name}", level, "seen", text, evidence, advice=ADVICE[name])


def _times(record: Record, series: Series) -> list[tuple[float, float]]:
    """Spans in the air in which measurements are rejected for long enough."""
    flying = record.airborne(series.time, 0.5)
    limit = TEST_RATIO if series.channel.rpartition(".")[2] != "innovation_check_flags" else 0.5
    return spans(series.time, (np.nan_to_num(series.values) > limit) & flying, REJECTED_FOR.warning)


def reset_statements(record: Record) -> Iterator[Statement]:
    """Jumps of the estimate in the air, and changes of the estimator's instance."""
    for name, series in record.autopilot.jumps.items():
        flying = record.airborne(series.time, 2.0) & np.isfinite(series.values)
        if not flying.any():
            continue
        place = int(np.argmax(np.where(flying, series.values, 0.0)))
        size, at = float(series.values[place]), float(series.time[place])
        level = level_of(size, JUMP)
        unit = "m/s" if name == "velocity" else "m"
        text = f"the estimator reset its {name} by {size:.2g} {unit} at {at:.1f} s in flight"
        evidence = Evidence(at, at, series.channel, size, unit, JUMP.warning)
        advice = "look at which sensor came, went or jumped then" if level else ""
        yield Statement(f"{name}_reset", level or "note", "seen", text, evidence, advice=advice)
    instance = record.autopilot.instance
    if instance is None or len(instance.values) < 2:
        return
    times = instance.time[np.flatnonzero(np.diff(instance.values) != 0) + 1]
    times = times[record.airborne(times)]
    if not len(times):
        return
    densest = max(int(((times >= t) & (times <= t + SWITCH_WINDOW)).sum()) for t in times)
    level = "fault" if densest >= SWITCHES.fault else "warning"
    text = (
        f"the estimator changed its instance {len(times)} times in flight, {densest} times within {SWITCH_WINDOW:.0f} s"
    )
    begins, ends, count = float(times[0]), float(times[-1]), float(len(times))
    evidence = Evidence(begins, ends, instance.channel, count, "changes", SWITCHES.warning)
    advice = (
        "one IMU, compass or barometer disagrees with its peers: compare them around these times, calibrate, exchange"
    )
    yield Statement("estimator_switches", level, "seen", text, evidence, advice=advice)


def gps_statements(record: Record) -> Iterator[Statement]:
    """A receiver without a fix: all the time, or lost in the air."""
    fix, own = record.autopilot.gps_fix, record.autopilot
    if fix is None or len(fix.values) < 2:
        return
    flown = fix.within(record.start, record.end)
    if len(flown.values) < 2:
        return
    if (fix.values < FIX_3D).all():
        satellites = own.gps_satellites.values.max() if own.gps_satellites is not None else 0
        source = "" if own.uses_gps is not False else "; the estimator did not use it and flew by another source"
        text = (
            f"the satellite receiver had no fix at any time ({satellites:.0f} satellites at most){source}: this is no"
        )
        text += " loss in flight, and whether something disturbs it the log cannot tell"
        evidence = Evidence(float(fix.time[0]), float(fix.time[-1]), fix.channel, float(fix.values.max()), "1", FIX_3D)
        yield Statement("no_gps_fix", "note", "seen", text, evidence)
        return
    lost = spans(flown.time, flown.values < FIX_3D, MIN_LOSS)
    if lost:
        text = f"the satellite receiver lost its fix at {lost[0][0]:.1f} s for {lost[0][1] - lost[0][0]:.1f} s"
        evidence = Evidence(*lost[0], flown.channel, float(flown.values.min()), "1", FIX_3D)
        level: Level = "warning" if own.uses_gps is False else "fault"
        advice = "look for shading, jamming, the antenna and its cable; compare the number of satellites"
        yield Statement("gps_lost", level, "seen", text, evidence, advice=advice)
        return
    accuracy = own.gps_accuracy
    if accuracy is not None and own.uses_gps is not False:
        part = accuracy.within(record.start, record.end)
        poor = spans(part.time, part.values > GPS_ACCURACY, MIN_LOSS)
        if poor:
            worst = float(np.nanmax(part.values))
            text = f"the satellite position is inaccurate from {poor[0][0]:.1f} s on, by up to {worst:.0f} m"
            evidence = Evidence(poor[0][0], poor[-1][1], part.channel, worst, "m", GPS_ACCURACY)
            yield Statement("gps_inaccurate", "warning", "seen", text, evidence, advice="look for shading and jamming")


def reported_statements(record: Record) -> Iterator[Statement]:
    """Failures of motors and ESCs and failsafes in the air, as the autopilot itself reported them."""
    for motor, series in record.autopilot.esc_failures.items():
        on = series.values != 0
        at = float(series.time[np.flatnonzero(on)[0]])
        rotor = record.layout.motor.index(motor) if record.layout and motor in record.layout.motor else None
        text = f"the ESC of motor {motor} reports failures (bits {int(series.values[on].max())}) from {at:.1f} s on"
        evidence = Evidence(at, float(series.time[on][-1]), series.channel, float(series.values[on].max()), "1", 0.0)
        yield Statement("esc_failure", "fault", "seen", text, evidence, rotor, f"look at the ESC of motor {motor}")
    for name, text, level in REPORTS:
        series_or_none = record.autopilot.flags.get(name)
        if series_or_none is None:
            continue
        rising = np.flatnonzero(np.diff(series_or_none.values, prepend=0.0) > 0)
        times = series_or_none.time[rising]
        times = times[record.airborne(times)]
        if len(times):
            at = float(times[0])
            evidence = Evidence(at, at, series_or_none.channel, 1.0, "1", 0.0)
            yield Statement(f"reported_{name.replace(' ', '_')}", level, "seen", f"{text} at {at:.1f} s", evidence)


REPORTS: tuple[tuple[str, str, Level], ...] = (
    ("failsafe", "the autopilot began a failsafe", "fault"),
    ("fd_motor", "the failure detector reported a motor", "fault"),
    ("fd_motor_failure", "the failure detector reported a motor", "fault"),
    ("fd_imbalanced_prop", "the failure detector reported an imbalanced propeller", "warning"),
    ("fd_roll", "the failure detector reported roll beyond its limit", "fault"),
    ("fd_pitch", "the failure detector reported pitch beyond its limit", "fault"),
    ("local_position_invalid", "the position became invalid", "fault"),
    ("crash check", "the crash check disarmed the vehicle", "fault"),
    ("thrust loss check", "the autopilot reported a loss of thrust", "fault"),
    ("EKF failsafe", "the autopilot began the EKF's failsafe", "fault"),
    ("EKF check", "the estimator's variances were too high", "fault"),
    ("battery failsafe", "the autopilot began the battery's failsafe", "fault"),
    ("radio failsafe", "the autopilot began the radio's failsafe", "fault"),
    ("vibration failsafe", "the autopilot began the vibration's failsafe", "fault"),
    ("GPS", "the autopilot reported a jump of the GPS", "warning"),
    ("compass", "the autopilot reported the compass unhealthy", "warning"),
)
