"""Rotors by their commands: balance in hover, a rotor that changed in flight, a rotor that stopped thrusting.

In hover the four commands of a quadrotor have four patterns: their mean, and what turns about roll, pitch and yaw. A
centre of mass off the middle is roll and pitch; a crooked motor is yaw; a weak rotor is all three at one corner.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from flights.health.answer import Evidence, Level, Statement
from flights.health.record import Record, spans
from flights.health.thresholds import (
    ATTITUDE_ERROR,
    ATTITUDE_ERROR_FOR,
    IMBALANCE,
    NEAR_LIMIT,
    SINGLE_ROTOR,
    STEP_OF_BALANCE,
)

HOVER_TILT = 0.2  # rad
HOVER_RATE = 0.7  # rad/s
HOVER_SPEED = 1.5  # m/s
MIN_HOVER = 3.0  # s
SETTLING = 1.0  # s after take-off and before landing
STOPPED_FOR = 0.25  # s at the upper limit while the opposite rotor is let down
LET_DOWN = 0.6  # of the mean command in hover


@dataclass(frozen=True)
class Balance:
    """Commands in hover over their mean, less 1. relative: (rotors,). start, end: s. seconds: of hover."""

    relative: Floats
    mean: float
    start: float
    end: float
    seconds: float
    source: str


def hover_rows(record: Record, time: Floats) -> np.ndarray:
    """(n,) which times are quiet hover: level, slow and without turning."""
    rows = record.airborne(time, SETTLING) & record.clear_of_ground(time)
    for name, limit in (("attitude", HOVER_TILT), ("rate", HOVER_RATE), ("velocity", HOVER_SPEED)):
        signal = record.values(name)
        if signal is None:
            continue
        own, values, _ = signal
        size = tilt(values) if name == "attitude" else np.linalg.norm(values, axis=1)
        rows &= np.interp(time, own, np.nan_to_num(size, nan=np.inf)) < limit
    return rows


def tilt(attitude: Floats) -> Floats:
    """(n,) angle between body z and world z, rad. attitude: (n, 4)."""
    w, x, y, z = attitude.T
    return np.asarray(np.arccos(np.clip(w * w - x * x - y * y + z * z, -1.0, 1.0)))


def balance(record: Record, start: float = 0.0, end: float = np.inf) -> Balance | None:
    """The balance within a span of time, by commands or else by measured speeds; None without enough hover."""
    signal = record.commands() or record.values("rotor_speed")
    if signal is None:
        return None
    time, command, source = signal
    rows = hover_rows(record, time) & (time >= start) & (time <= end) & np.isfinite(command).all(axis=1)
    seconds = rows.sum() * float(np.median(np.diff(time)))
    if seconds < MIN_HOVER or command.shape[1] < 3:
        return None
    mean = command[rows].mean(axis=0)
    if mean.mean() < 0.02:
        return None
    own = time[rows]
    return Balance(mean / mean.mean() - 1, float(mean.mean()), float(own[0]), float(own[-1]), float(seconds), source)


def balance_statements(record: Record) -> Iterator[Statement]:
    """Weak rotor, centre of mass, crooked motor; a change within the flight before a pattern that was always there."""
    flown = balance(record)
    if flown is None:
        return
    changed = _changed(record, flown)
    if changed is not None:
        yield changed
        return
    largest = float(np.abs(flown.relative).max())
    if largest < IMBALANCE.warning:
        rotor = int(np.abs(flown.relative).argmax())
        text = f"rotors are balanced in hover within {100 * largest:.0f} %, {record.motor_name(rotor)} the farthest"
        yield Statement("balance", "note", "seen", text, _evidence(flown, largest))
        return
    yield _pattern(record, flown, largest)


def _evidence(hovering: Balance, value: float) -> Evidence:
    channel = f"{hovering.source}, rotor over the mean less 1"
    return Evidence(hovering.start, hovering.end, channel, value, "1", IMBALANCE.warning)


def _pattern(record: Record, hovering: Balance, largest: float) -> Statement:
    """The statement about a pattern that lasts the flown flight."""
    level: Level = "fault" if largest > IMBALANCE.fault else "warning"
    rotor = int(np.abs(hovering.relative).argmax())
    name, evidence = record.motor_name(rotor), _evidence(hovering, largest)
    shares = ", ".join(f"{100 * value:+.0f} %" for value in hovering.relative)
    if record.layout is None or len(hovering.relative) != 4:
        text = f"the rotors' commands in hover differ from their mean by {shares}: why, the log does not tell"
        return Statement("imbalance", level, "cannot tell", text, evidence, rotor, f"compare {name} with its peers")
    x, y, _ = np.array(record.layout.position).T
    spin = np.array(record.layout.spin, dtype=float)
    corner = hovering.relative @ np.stack([np.sign(x), np.sign(y), spin], axis=1) / 4  # pitch, roll, yaw
    pitch, roll, yaw = corner.tolist()
    if abs(yaw) > 2.0 * max(abs(pitch), abs(roll)):
        pair = "counter-clockwise" if yaw * -1 > 0 else "clockwise"
        text = (
            f"the {pair} pair of rotors works {200 * abs(yaw):.0f} % harder than the other: a motor or arm is turned "
            "out of its plane, or the propellers of one pair are worn"
        )
        return Statement("yaw_imbalance", level, "likely", text, evidence, None, "level the motors and arms")
    is_corner = min(abs(pitch), abs(roll)) > 0.5 * max(abs(pitch), abs(roll))
    loaded = int(np.argmax(np.sign(x) * pitch + np.sign(y) * roll))
    single = (abs(pitch) + abs(roll)) / 2
    supports = yaw * spin[loaded] / single if is_corner else 0.0
    if is_corner and supports > SINGLE_ROTOR:
        text = (
            f"{record.motor_name(loaded)} works {400 * single:.0f} % harder than the others in hover ({shares}), and "
            "the yaw pattern says that it is this rotor alone: a damaged propeller or a weak motor"
        )
        advice = f"exchange the propeller of {record.motor_name(loaded)}, then its motor and ESC with another one's"
        return Statement("weak_thrust", level, "likely", text, evidence, loaded, advice)
    side = " and ".join(
        part for part in (("front" if pitch > 0 else "back") if abs(pitch) > 0.3 * abs(roll) else "",
                          ("left" if roll > 0 else "right") if abs(roll) > 0.3 * abs(pitch) else "") if part
    )  # fmt: skip
    if is_corner:
        text = (
            f"the {side} carries more in hover ({shares}): the centre of mass lies towards "
            f"{record.motor_name(loaded)}, or that rotor is weak; hover alone does not decide"
        )
        advice = f"exchange the propellers of {record.motor_name(loaded)} and its opposite, and fly again"
        return Statement("weak_thrust_or_off_centre", level, "cannot tell", text, evidence, loaded, advice)
    text = f"the {side} carries more in hover ({shares}): the centre of mass lies there"
    return Statement("off_centre", level, "likely", text, evidence, None, f"move the load away from the {side}")


def _changed(record: Record, flown: Balance) -> Statement | None:
    """A rotor whose command in hover rose within the flight, while its peers' did not."""
    signal = record.commands()
    if signal is None or flown.seconds < 3 * MIN_HOVER or len(flown.relative) != 4:
        return None
    time, command, source = signal
    rows = hover_rows(record, time) & np.isfinite(command).all(axis=1)
    own, relative = time[rows], command[rows] / command[rows].mean(axis=1, keepdims=True) - 1
    size = len(own)
    edge = max(3, int(MIN_HOVER * size / flown.seconds))
    sums = np.concatenate([np.zeros((1, 4)), np.cumsum(relative, axis=0)])
    cuts = np.arange(edge, size - edge)
    if not len(cuts):
        return None
    before = sums[cuts] / cuts[:, None]
    after = (sums[-1] - sums[cuts]) / (size - cuts)[:, None]
    steps = after - before
    weight = np.sqrt(cuts * (size - cuts) / size)
    cut = int(np.argmax(weight * np.abs(steps).max(axis=1)))
    step, rotor = steps[cut], int(np.argmax(steps[cut]))
    scatter = float(np.median(np.abs(np.diff(relative[:, rotor])))) + 1e-6
    if step[rotor] < STEP_OF_BALANCE or step[rotor] < 2.0 * scatter or step[rotor] < 1.6 * np.delete(step, rotor).max():
        return None
    at = float(own[cuts[cut]])
    if not _is_sudden(own, relative[:, rotor], at, float(step[rotor])):
        return None
    text = (
        f"{record.motor_name(rotor)} needs {100 * step[rotor]:.0f} % more command from {at:.1f} s on, its peers do "
        "not: its propeller was damaged, or its motor or ESC became weak, in flight"
    )
    evidence = Evidence(at, flown.end, f"{source}, step of the command over the mean", float(step[rotor]), "1",
                        STEP_OF_BALANCE)  # fmt: skip
    level: Level = "fault" if step[rotor] > IMBALANCE.warning else "warning"
    advice = f"exchange the propeller of {record.motor_name(rotor)}, then look at its motor, ESC and their connectors"
    return Statement("weak_thrust", level, "likely", text, evidence, rotor, advice)


def _is_sudden(time: Floats, values: Floats, at: float, step: float) -> bool:
    """Whether most of a change lies within 2 s around a time: a payload or a battery moves slowly or never."""
    near_before = values[(time > at - 3.0) & (time < at - 0.3)]
    near_after = values[(time > at + 0.7) & (time < at + 4.0)]
    if len(near_before) < 5 or len(near_after) < 5:
        return True
    return bool(np.median(near_after) - np.median(near_before) > 0.5 * step)


def lost_control(record: Record) -> tuple[float, float] | None:
    """Start and end of the first time in the air in which the attitude left its setpoint, s."""
    attitude, setpoint = record.values("attitude"), record.values("attitude_setpoint")
    if attitude is None:
        return None
    time, values, _ = attitude
    angle = tilt(values)
    away = angle > 2 * ATTITUDE_ERROR + 0.2
    if setpoint is not None:
        rows = np.clip(np.searchsorted(setpoint[0], time, side="right") - 1, 0, None)
        away |= tilt_between(values, setpoint[1][rows]) > ATTITUDE_ERROR
    times = spans(time, away & record.airborne(time), ATTITUDE_ERROR_FOR)
    return times[0] if times else None


def tilt_between(a: Floats, b: Floats) -> Floats:
    """(n,) angle between the body z axes of two attitudes, rad; NaN where either is none."""
    up = np.array([0.0, 0.0, 1.0])
    za, zb = (quaternion.rotate(q, np.broadcast_to(up, (len(q), 3))) for q in (a, b))
    return np.asarray(np.arccos(np.clip(np.sum(za * zb, axis=1), -1.0, 1.0)))


def stopped_statement(record: Record) -> Statement | None:
    """A rotor at its limit against which the vehicle turns over: it thrusts no more."""
    lost, signal = lost_control(record), record.commands()
    if lost is None or signal is None or record.layout is None or len(record.layout.position) != signal[1].shape[1]:
        return None
    time, command, source = signal
    hover = balance(record)
    usual = hover.mean if hover is not None else float(np.nanmedian(command[record.airborne(time)]))
    rows = (time >= lost[0] - 1.5) & (time <= lost[0] + 1.0)
    if rows.sum() < 4:
        return None
    own = command[rows]
    x, y, _ = np.array(record.layout.position).T
    best: tuple[float, int, float] | None = None
    for rotor in range(own.shape[1]):
        opposite = int(np.argmin(x * x[rotor] + y * y[rotor]))
        driven = (own[:, rotor] >= NEAR_LIMIT) & (own[:, opposite] < LET_DOWN * usual)
        held = spans(time[rows], driven, STOPPED_FOR)
        if held and (best is None or held[0][0] < best[2]):
            best = (held[0][1] - held[0][0], rotor, held[0][0])
    if best is None:
        return None
    seconds, rotor, start = best
    if not _falls_towards(record, rotor, start, lost[0] + 0.5):
        return None
    name = record.motor_name(rotor)
    text = (
        f"{name} stopped thrusting at {start:.1f} s: its command went to the limit and the opposite one's down, yet "
        f"the vehicle tipped towards {name}"
    )
    advice = f"look at the propeller, motor, ESC and wiring of {name}; its ESC's log or temperature tells which"
    evidence = Evidence(start, start + seconds, source, float(own[:, rotor].max()), "1", NEAR_LIMIT)
    return Statement("stopped_rotor", "fault", "likely", text, evidence, rotor, advice)


def _falls_towards(record: Record, rotor: int, start: float, end: float) -> bool:
    """Whether the body rates between two times turn the vehicle towards a rotor's place."""
    signal = record.values("rate")
    if signal is None or record.layout is None:
        return False
    time, rate, _ = signal
    rows = (time >= start - 0.3) & (time <= end)
    x, y, _ = record.layout.position[rotor]
    towards = rate[rows, 1] * np.sign(x) - rate[rows, 0] * np.sign(
        y
    )  # FLU: pitch rate lowers the front, roll the right
    return bool(len(towards) and np.nanmean(towards) > 0.3)
