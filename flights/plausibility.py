"""Checks of a log's units and frames, by streams that must agree.

Each check compares two streams that must agree whatever was flown: velocity with the change of position, body rates
with the change of attitude, specific force with gravity, horizontal acceleration with tilt. A flight that moved too
little for a comparison passes it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from flights.alignment import resample
from flights.log import Stream
from flights.quantities import MOTION

if TYPE_CHECKING:
    from flights.flight import Flight

_GRID_RATE = 50.0  # Hz of the comparisons
_MAX_ROWS = 60_000  # rows compared at most
_SMOOTHING = 0.2  # s, over which differences are taken: far above any sensor's delay
_MAX_PERIOD = {"rate": 0.9, "attitude": 0.9, "specific_force": 0.9, "position": 3.0, "velocity": 3.0}  # s
_MAX_RATE = 100.0  # rad/s; gyroscopes end at 35 to 70
_MIN_RATE = 0.1  # rad/s rms, below which attitude and rates cannot be compared
_MIN_SPEED = 0.15  # m/s rms
_CLEAR_SPEED = 0.35  # m/s rms along an axis, beyond what an estimator's errors (0.2) make of position and velocity
_OPPOSITE = 0.2  # of a slower axis's size: how little the sum of two opposite signals is
_MIN_ACCELERATION = 0.3  # m/s^2 rms
_AGREEMENT = 0.5  # correlation about zero beyond which a comparison is taken seriously
_CLEAR_AGREEMENT = 0.8  # correlation about zero of one motion logged along two axes
_CLEARER = 0.3  # by which that must exceed the correlation along equal axes
_NO_AGREEMENT = 0.2  # correlation about zero below which there is none
_DEGREES = 180 / np.pi
_MAX_SHIFT = 0.5  # s between two clocks that is tried
_CLEAR_SHIFT = 0.08  # s beyond which no sensor is late in a usable log: further than the effect time_delay is searched
_BETTER = 0.05  # by which the correlation must rise at that shift; others' logs with one clock: 0.016 at most
_MIN_LATERAL = 0.2  # m/s^2 rms of force along body x and y that both sensors must show
_MIN_TILT_FORCE = 0.5  # m/s^2 rms of the thrust's horizontal part, below which body and world axes look alike
_SAME_SIZE = (0.6, 1.67)  # range of a ratio that must be 1
_WORLD_AXES = 0.8  # correlation about zero of specific force and tilt, beyond which it is in world axes
_CLIPPED = 0.01  # share of values at the largest, from which on a range ends there
_DEAD = 0.005  # of the turning that an axis of the gyro must show
_CLEAR_RATE = 0.15  # rad/s rms about an axis, at which it must show it


@dataclass(frozen=True)
class Contradiction:
    """A contradiction between streams.

    name: for programs.
    text: the observation, what was expected, and what to do.
    """

    name: str
    text: str


def check(streams: Sequence[Stream]) -> tuple[Contradiction, ...]:
    """Every contradiction of units and frames; empty when the streams agree or move too little."""
    first: dict[str, Stream] = {}
    for stream in streams:
        first.setdefault(stream.name, stream)
    grid = _grid(list(first.values()))
    on_grid: dict[str, Floats] = {name: resample(first[name], grid) for name in MOTION if name in first}
    contradictions = [
        _too_slow(first),
        _impossible_rates(first),
        _rates_against_attitude(on_grid),
        _gravity(on_grid),
        _velocity_against_position(on_grid),
        _tilt_against_acceleration(on_grid),
        _force_against_acceleration(on_grid),
        _force_against_tilt(on_grid),
        _lateral_force(on_grid),
        _clocks(on_grid),
    ]
    return tuple(finding for finding in contradictions if finding is not None)


def check_flight(flight: Flight, free: Sequence[Flight]) -> tuple[Contradiction, ...]:
    """The same of a flight's columns while it flies. free: its segments of free flight."""
    flying = np.zeros(len(flight), dtype=bool)
    for part in free:
        flying |= (flight.time >= part.time[0]) & (flight.time <= part.time[-1])
    present = [name for name in MOTION if flight.has(name)]
    streams = [Stream(name, flight.time, np.where(flying[:, None], flight[name], np.nan), "") for name in present]
    return check(streams) if flying.any() else ()


def _grid(streams: list[Stream]) -> Floats:
    start = min((float(stream.time[0]) for stream in streams), default=0.0)
    end = max((float(stream.time[-1]) for stream in streams), default=0.0)
    count = min(int((end - start) * _GRID_RATE) + 1, _MAX_ROWS)
    return np.asarray(start + np.arange(count) / _GRID_RATE)


def _too_slow(first: dict[str, Stream]) -> Contradiction | None:
    """Attitude or gyro at the period of no flight log: the time is in a shorter unit than seconds."""
    for name, longest in _MAX_PERIOD.items():
        if name in first and longest < first[name].period < float("inf"):
            return Contradiction(
                "time_unit",
                f"the {name} comes every {first[name].period:.3g} s, which is no flight log's rate: the time is not in "
                "seconds. Wanted seconds; divide it, or give a column mapping with its unit (ms, us, ns).",
            )
    return None


def _impossible_rates(first: dict[str, Stream]) -> Contradiction | None:
    if "rate" not in first:
        return None
    rates = first["rate"].values
    if not np.isfinite(rates).any():
        return None
    largest = float(np.nanpercentile(np.abs(rates), 99.5))
    if largest <= _MAX_RATE:
        return None
    return Contradiction(
        "rates_in_degrees",
        f"the body rates reach {largest:.0f} rad/s, which no gyroscope measures: they are in deg/s. Wanted rad/s; "
        "multiply by pi/180, or give a column mapping with unit = 'deg/s'.",
    )


def _rates_against_attitude(on_grid: dict[str, Floats]) -> Contradiction | None:
    """Body rates must be those by which the attitude turns, on every axis that turns."""
    if not {"attitude", "rate"} <= on_grid.keys():
        return None
    span = max(1, round(_SMOOTHING * _GRID_RATE))
    attitude, rate = on_grid["attitude"], _mean(on_grid["rate"], span)
    turned = quaternion.logarithm(quaternion.multiply(quaternion.conjugate(attitude[:-span]), attitude[span:]))
    turning = turned / (span / _GRID_RATE)
    valid = np.isfinite(turning).all(axis=1) & np.isfinite(rate).all(axis=1)
    valid &= np.linalg.norm(turned, axis=1) < 1.5  # a long turn between two samples is no rotation vector's rate
    if np.count_nonzero(valid) < 50:
        return None
    turning, rate = turning[valid], rate[valid]
    speed = _rms(turning)
    if speed < _MIN_RATE:
        return None
    ratio = _rms(rate) / speed
    if 0.5 * _DEGREES < ratio < 2 * _DEGREES:
        return Contradiction(
            "rates_in_degrees",
            f"the body rates are {ratio:.0f} times those by which the attitude turns: they are in deg/s. Wanted rad/s.",
        )
    agreement = _agreement(turning, rate)
    if agreement > _AGREEMENT and not _may_be_one_size(ratio, agreement) and not _clips(on_grid["rate"]):
        return Contradiction(
            "rate_unit",
            f"the body rates are {ratio:.2f} times those by which the attitude turns. Wanted rad/s; check the scale.",
        )
    for axis in range(3):
        a, b = turning[:, axis], rate[:, axis]
        if min(_rms(a), _rms(b)) > _MIN_RATE and _agreement(a, b) < -_AGREEMENT:
            return Contradiction(
                "rate_frame",
                f"the body rate about {'xyz'[axis]} has the opposite sign of the attitude's turning: they are not in "
                "the same axes (FRD and FLU?), or the attitude is world to body. Wanted both in body FLU, w first.",
            )
    exchanged = _exchanged_axes(turning, rate, _MIN_RATE)
    if exchanged:
        return Contradiction(
            "rate_frame",
            f"the body rates are along other axes than the attitude's turning ({exchanged}). Wanted both in body FLU, "
            "x forward, y left, z up; put the columns in order.",
        )
    return _dead_axis(turning, rate)


def _clips(values: Floats) -> bool:
    """Whether values (n, k) stay at their largest, as at the end of a range."""
    size = np.abs(values[np.isfinite(values)])
    return float(np.mean(size >= (1 - 1e-6) * size.max())) > _CLIPPED


def _dead_axis(turning: Floats, rate: Floats) -> Contradiction | None:
    """An axis of the gyro that shows nothing of the attitude's turning. Both: (n, 3) rad/s."""
    for axis in range(3):
        clear = _rms(turning[:, axis])
        if clear > _CLEAR_RATE and float(np.std(rate[:, axis])) < _DEAD * clear:
            return Contradiction(
                "rate_dead",
                f"the body rate about {'xyz'[axis]} stands still while the attitude turns about it by {clear:.2f} "
                "rad/s: that column is no gyro. Wanted all three; check the sensor, or leave the rates out.",
            )
    return None


def _gravity(on_grid: dict[str, Floats]) -> Contradiction | None:
    """The specific force must point up with about g, or with what the velocity's change needs: a fall is no unit."""
    if "specific_force" not in on_grid:
        return None
    force = on_grid["specific_force"]
    attitude = on_grid.get("attitude")
    valid = np.isfinite(force).all(axis=1)
    if attitude is not None:
        valid &= np.isfinite(attitude).all(axis=1)
    if np.count_nonzero(valid) < 20:
        return None
    up = force[valid] if attitude is None else quaternion.rotate(attitude[valid], force[valid])
    mean = np.median(up, axis=0)
    if mean[2] < -0.5 * GRAVITY:
        return Contradiction(
            "frames_upside_down",
            f"the specific force points down ({mean[2]:.1f} m/s^2 along z): these are FRD or NED axes. Wanted FLU and "
            "ENU, where gravity's reaction points up; convert them, or give a column mapping with its frames.",
        )
    size = float(np.linalg.norm(mean))
    if any(_SAME_SIZE[0] < size / needed < _SAME_SIZE[1] for needed in (GRAVITY, _needed_force(on_grid)) if needed):
        return None
    if _SAME_SIZE[0] < size < _SAME_SIZE[1]:
        return Contradiction("force_in_g", f"the specific force is {size:.2f} on average: it is in g. Wanted m/s^2.")
    if size < _SAME_SIZE[0]:
        return Contradiction(
            "gravity_removed",
            f"the specific force is {size:.2f} m/s^2 on average: gravity's reaction was removed from it. Wanted what "
            "an accelerometer reads, 9.81 m/s^2 upwards at rest; if the table holds accelerations, map them so.",
        )
    return Contradiction(
        "force_unit",
        f"the specific force is {size:.3g} m/s^2 on average, wanted about 9.81: it is in another unit (mg, cm/s^2) or "
        "of another scale.",
    )


def _needed_force(on_grid: dict[str, Floats]) -> float:
    """Size of the median specific force that the motion needs, m/s^2; 0 where no velocity tells."""
    if "velocity" not in on_grid:
        return 0.0
    span = max(1, round(_SMOOTHING * _GRID_RATE))
    gained = (on_grid["velocity"][span:] - on_grid["velocity"][:-span]) * (_GRID_RATE / span)
    gained = gained[np.isfinite(gained).all(axis=1)]
    if len(gained) < 20:
        return 0.0
    return float(np.linalg.norm(np.median(gained, axis=0) + np.array([0.0, 0.0, GRAVITY])))


def _velocity_against_position(on_grid: dict[str, Floats]) -> Contradiction | None:
    if not {"position", "velocity"} <= on_grid.keys():
        return None
    span = max(1, round(_SMOOTHING * _GRID_RATE))
    moved = (on_grid["position"][span:] - on_grid["position"][:-span]) / (span / _GRID_RATE)
    velocity = _mean(on_grid["velocity"], span)
    valid = np.isfinite(moved).all(axis=1) & np.isfinite(velocity).all(axis=1)
    if np.count_nonzero(valid) < 50:
        return None
    speed = np.linalg.norm(np.nan_to_num(moved), axis=1)
    valid &= speed < max(50.0, 20.0 * float(np.median(speed[valid])))  # an estimator's reset is no motion
    unit = _unit_of_position(moved[valid], velocity[valid])
    if unit is not None:
        return unit
    for axis in range(3):
        a, b = moved[valid, axis], velocity[valid, axis]
        if _is_opposite_motion(a, b):
            return Contradiction(
                "velocity_frame",
                f"the velocity along {'xyz'[axis]} has the opposite sign of the position's change: they are not in the "
                "same axes (NED and ENU?). Wanted both in ENU.",
            )
    exchanged = _exchanged_axes(moved[valid], velocity[valid], _MIN_SPEED)
    if exchanged:
        return Contradiction(
            "velocity_frame",
            f"the velocity is along other axes than the position's change ({exchanged}). Wanted both in ENU; put the "
            "columns in order.",
        )
    return None


def _is_opposite_motion(one: Floats, other: Floats) -> bool:
    """Whether one velocity along an axis is the other with the opposite sign, not two errors of an estimator. m/s."""
    speed = min(_rms(one), _rms(other))
    if speed > _CLEAR_SPEED:
        return _agreement(one, other) < -_AGREEMENT
    return speed > _MIN_SPEED and _rms(one + other) < _OPPOSITE * speed


def _unit_of_position(moved: Floats, velocity: Floats) -> Contradiction | None:
    """The change of position and the velocity must be of one size. Both: (n, 3) m/s."""
    moved, velocity = moved - np.median(moved, axis=0), velocity - np.median(velocity, axis=0)
    if _rms(velocity) < _MIN_SPEED or _rms(moved) == 0.0:
        return None
    ratio, agreement = _rms(moved) / _rms(velocity), _agreement(moved, velocity)
    if agreement < _AGREEMENT or _may_be_one_size(ratio, agreement):
        return None
    names = {1000.0: "mm", 100.0: "cm"}
    guess = ""
    for factor, unit in names.items():
        if _SAME_SIZE[0] < ratio / factor < _SAME_SIZE[1]:
            guess = f": position is in {unit} beside a velocity in m/s"
        if _SAME_SIZE[0] < ratio * factor < _SAME_SIZE[1]:
            guess = f": velocity is in {unit}/s beside a position in m"
    return Contradiction(
        "position_unit",
        f"the position changes by {ratio:.3g} times the velocity{guess}. Wanted m and m/s; convert them, or give a "
        "column mapping with their units.",
    )


def _exchanged_axes(one: Floats, other: Floats, smallest: float) -> str:
    """Pairs of axes that agree while equal axes do not, for people; empty if there are none. Both: (n, 3).

    All axes that an order of the columns displaces must say so: one that errs by more than it moves resembles another
    axis along which the vehicle moves with it.
    """
    for order in itertools.permutations(range(3)):
        moving = [(i, j) for i, j in enumerate(order) if i != j and max(_rms(one[:, i]), _rms(other[:, j])) >= smallest]
        if moving and all(_is_another_axis(one[:, i], other[:, i], other[:, j]) for i, j in moving):
            return ", ".join(f"{'xyz'[i]} and {'xyz'[j]}: {_agreement(one[:, i], other[:, j]):.2f}" for i, j in moving)
    return ""


def _is_another_axis(one: Floats, own: Floats, another: Floats) -> bool:
    """Whether a motion agrees with what was logged along another axis, and not with its own. All: (n,)."""
    if 0.0 in (_rms(one), _rms(own), _rms(another)):
        return False
    agreement = abs(_agreement(one, another))
    return agreement > max(_CLEAR_AGREEMENT, abs(_agreement(one, own)) + _CLEARER)


def _tilt_against_acceleration(on_grid: dict[str, Floats]) -> Contradiction | None:
    """Thrust acts along body z: a multirotor that tilts to the east accelerates east."""
    if not {"attitude", "velocity"} <= on_grid.keys():
        return None
    span = max(1, round(_SMOOTHING * _GRID_RATE))
    acceleration = (on_grid["velocity"][span:] - on_grid["velocity"][:-span]) / (span / _GRID_RATE)
    thrust_direction = _mean(GRAVITY * quaternion.rotate(on_grid["attitude"], np.array([0.0, 0.0, 1.0])), span)
    valid = np.isfinite(acceleration).all(axis=1) & np.isfinite(thrust_direction).all(axis=1)
    if np.count_nonzero(valid) < 50:
        return None
    a, b = acceleration[valid, :2], thrust_direction[valid, :2]
    if min(_rms(a), _rms(b)) < _MIN_ACCELERATION:
        return None
    agreement = _agreement(a, b)
    exchanged = _agreement(a, b[:, ::-1])
    if agreement < _NO_AGREEMENT and exchanged > _AGREEMENT:
        return Contradiction(
            "attitude_frame",
            f"the vehicle accelerates along x where its thrust tilts along y (agreement {agreement:.2f}, exchanged "
            f"{exchanged:.2f}): attitude and velocity are not in the same axes, as NED labelled as ENU. Wanted ENU and "
            "FLU; convert them, or give a column mapping.",
        )
    if agreement > -_AGREEMENT:
        return None
    return Contradiction(
        "attitude_frame",
        f"the vehicle accelerates away from where its thrust points (agreement {agreement:.2f}): attitude and velocity "
        "are not in the same axes, as NED labelled as ENU. Wanted ENU and FLU; convert them, or give a column mapping.",
    )


def _force_against_acceleration(on_grid: dict[str, Floats]) -> Contradiction | None:
    """Vertical acceleration agrees between accelerometer and velocity."""
    if not {"attitude", "velocity", "specific_force"} <= on_grid.keys():
        return None
    span = max(1, round(_SMOOTHING * _GRID_RATE))
    climb = on_grid["velocity"][:, 2:]
    acceleration = (climb[span:] - climb[:-span]) / (span / _GRID_RATE)
    measured = _mean(quaternion.rotate(on_grid["attitude"], on_grid["specific_force"])[:, 2:] - GRAVITY, span)
    valid = np.isfinite(acceleration[:, 0]) & np.isfinite(measured[:, 0])
    if np.count_nonzero(valid) < 50:
        return None
    a, b = acceleration[valid], measured[valid] - np.median(measured[valid])
    if min(_rms(a), _rms(b)) < _MIN_ACCELERATION or _agreement(a, b) > -_AGREEMENT:
        return None
    return Contradiction(
        "velocity_frame",
        f"the velocity along z falls while the specific force exceeds gravity (agreement {_agreement(a, b):.2f}): "
        "position and velocity are NED labelled as ENU. Wanted z up; convert them, or give a column mapping.",
    )


def _force_against_tilt(on_grid: dict[str, Floats]) -> Contradiction | None:
    """Specific force is measured along body axes, and shows nothing there of the thrust's horizontal part."""
    if not {"attitude", "specific_force"} <= on_grid.keys():
        return None
    span = max(1, round(_SMOOTHING * _GRID_RATE))
    force = on_grid["specific_force"]
    size = np.linalg.norm(force, axis=1, keepdims=True)
    tilted = _mean(size * quaternion.rotate(on_grid["attitude"], np.array([0.0, 0.0, 1.0])), span)[:, :2]
    logged = _mean(force, span)[:, :2]
    valid = np.isfinite(tilted).all(axis=1) & np.isfinite(logged).all(axis=1)
    if np.count_nonzero(valid) < 50:
        return None
    a, b = logged[valid] - np.median(logged[valid], axis=0), tilted[valid] - np.median(tilted[valid], axis=0)
    if _rms(b) < _MIN_TILT_FORCE or not _SAME_SIZE[0] < _rms(a) / _rms(b) < _SAME_SIZE[1]:
        return None
    if _agreement(a, b) < _WORLD_AXES:
        return None
    return Contradiction(
        "force_frame",
        "the specific force along x and y is that of the thrust's tilt in the world (agreement "
        f"{_agreement(a, b):.2f}): it is in world axes. Wanted body FLU, where an accelerometer measures; rotate it "
        "back by the attitude.",
    )


def _pose_force(on_grid: dict[str, Floats]) -> Floats:
    """(n - span, 3) specific force along body axes that the motion of the pose has, m/s^2."""
    span = max(1, round(_SMOOTHING * _GRID_RATE))
    acceleration = (on_grid["velocity"][span:] - on_grid["velocity"][:-span]) / (span / _GRID_RATE)
    middle = on_grid["attitude"][span // 2 : span // 2 + len(acceleration)]
    return np.asarray(quaternion.rotate_inverse(middle, acceleration + np.array([0.0, 0.0, GRAVITY])))


def _lateral_force(on_grid: dict[str, Floats]) -> Contradiction | None:
    """Along body x and y the accelerometer reads the drag that slows the vehicle."""
    if not {"attitude", "velocity", "specific_force"} <= on_grid.keys():
        return None
    span = max(1, round(_SMOOTHING * _GRID_RATE))
    pose, logged = _pose_force(on_grid)[:, :2], _mean(on_grid["specific_force"], span)[:, :2]
    valid = np.isfinite(pose).all(axis=1) & np.isfinite(logged).all(axis=1)
    if np.count_nonzero(valid) < 50:
        return None
    a, b = pose[valid] - np.median(pose[valid], axis=0), logged[valid] - np.median(logged[valid], axis=0)
    for axis in range(2):
        one, other = a[:, axis], b[:, axis]
        if min(_rms(one), _rms(other)) > _MIN_LATERAL and _agreement(one, other) < -_AGREEMENT:
            return Contradiction(
                "force_frame",
                f"the specific force along {'xy'[axis]} has the opposite sign of what the pose's motion needs "
                f"(agreement {_agreement(one, other):.2f}): its axes are not the body's. Wanted body FLU.",
            )
    return None


def _clocks(on_grid: dict[str, Floats]) -> Contradiction | None:
    """Streams of one motion must show it at one time."""
    span = max(1, round(_SMOOTHING * _GRID_RATE))
    pairs: list[tuple[str, Floats, Floats]] = []
    if {"attitude", "rate"} <= on_grid.keys():
        attitude = on_grid["attitude"]
        turned = quaternion.logarithm(quaternion.multiply(quaternion.conjugate(attitude[:-span]), attitude[span:]))
        pairs.append(("the body rates are", turned * (_GRID_RATE / span), _mean(on_grid["rate"], span)))
    if {"position", "velocity"} <= on_grid.keys():
        moved = (on_grid["position"][span:] - on_grid["position"][:-span]) * (_GRID_RATE / span)
        pairs.append(("the velocity is", moved, _mean(on_grid["velocity"], span)))
    if {"attitude", "velocity", "specific_force"} <= on_grid.keys():
        world = quaternion.rotate(on_grid["attitude"], on_grid["specific_force"]) - np.array([0.0, 0.0, GRAVITY])
        gained = (on_grid["velocity"][span:] - on_grid["velocity"][:-span]) * (_GRID_RATE / span)
        pairs.append(("the accelerometer's clock, or the attitude's, is", gained, _mean(world, span)))
    for name, one, other in pairs:
        seconds, gained_agreement = _clock_offset(one, other)
        if abs(seconds) >= _CLEAR_SHIFT and gained_agreement > _BETTER:
            late = "late" if seconds > 0 else "early"
            return Contradiction(
                "clock",
                f"{name} {abs(seconds):.2f} s {late} against the rest of the motion. Wanted one clock; stamp samples "
                "when they are measured, or shift the columns.",
            )
    return None


def _clock_offset(one: Floats, other: Floats) -> tuple[float, float]:
    """By how much the other is late, s, and the rise of their correlation at that shift; zeros where none is clear."""
    best, plain, at = -1.0, 0.0, 0
    reach = round(_MAX_SHIFT * _GRID_RATE)
    if len(one) <= 2 * reach:
        return 0.0, 0.0
    for shift in range(-reach, reach + 1):
        a = one[max(-shift, 0) : len(one) - max(shift, 0)]
        b = other[max(shift, 0) : len(other) - max(-shift, 0)]
        valid = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
        if np.count_nonzero(valid) < 50:
            return 0.0, 0.0
        a, b = a[valid], b[valid]
        if min(_rms(a), _rms(b)) < _MIN_RATE:
            return 0.0, 0.0
        agreement = _agreement(a, b)
        plain = agreement if shift == 0 else plain
        if agreement > best:
            best, at = agreement, shift
    return (at / _GRID_RATE, best - plain) if best > _CLEAR_AGREEMENT else (0.0, 0.0)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _may_be_one_size(ratio: float, agreement: float) -> bool:
    """Whether two signals of one size may have such a ratio of RMS: of slow motion one may be noise for the most part.

    Noise in one of two equal signals makes it larger by the inverse of their correlation.
    """
    return agreement > 0 and _SAME_SIZE[0] * agreement < ratio < _SAME_SIZE[1] / agreement


def _agreement(one: Floats, other: Floats) -> float:
    """Correlation about zero: 1 for the same motion, -1 for the opposite one, 0 where one stands still."""
    size = _rms(one) * _rms(other)
    return float(np.mean(one * other)) / size if size > 0 else 0.0


def _mean(values: Floats, span: int) -> Floats:
    """Mean over each interval of `span` steps by the trapezium rule: (n - span, k)."""
    steps = 0.5 * (values[1:] + values[:-1])
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(np.nan_to_num(steps, nan=0.0), axis=0)])
    gaps = np.concatenate([[0], np.cumsum(~np.isfinite(steps).all(axis=1))])
    mean = (sums[span:] - sums[:-span]) / span
    return np.where((gaps[span:] - gaps[:-span])[:, None] > 0, np.nan, mean)
