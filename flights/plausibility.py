"""Checks of a log's units and frames, by streams that must agree.

Each check compares two streams that must agree whatever was flown: velocity with the change of position, body rates
with the change of attitude, specific force with gravity, horizontal acceleration with tilt. A flight that moved too
little for a comparison passes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from flights.agreement import (
    AGREEMENT,
    SAME_SIZE,
    agreement,
    both,
    exchanged_axes,
    is_opposite,
    may_be_one_size,
    offset,
    rms,
)
from flights.alignment import resample
from flights.log import Stream, spanning_streams
from flights.quantities import MOTION

_GRID_RATE = 50.0  # Hz of the comparisons
_MAX_ROWS = 60_000  # rows compared at most
_SPAN = 10  # steps, 0.2 s, over which differences are taken: far above any sensor's delay
_MAX_RATE = 100.0  # rad/s; gyroscopes end at 35 to 70
_MIN_RATE = 0.1  # rad/s rms, below which attitude and rates cannot be compared
_MIN_SPEED = 0.15  # m/s rms
_ERROR_OF_SPEED = 0.35  # m/s rms that an estimator's position and velocity may be apart: each errs by up to 0.23
_MIN_ACCELERATION = 0.3  # m/s^2 rms
_NO_AGREEMENT = 0.2  # correlation about zero below which there is none
_DEGREES = 180 / np.pi
_MAX_SHIFT = 0.5  # s between two clocks that is tried
_CLEAR_SHIFT = 0.08  # s beyond which no sensor is late in a usable log: further than the effect time_delay is searched
_BETTER = 0.05  # by which the correlation must rise at that shift; others' logs with one clock: 0.016 at most
_MIN_TILT_FORCE = 0.5  # m/s^2 rms of the thrust's horizontal part, below which body and world axes look alike
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
        _impossible_rates(first),
        _rates_against_attitude(on_grid),
        _gravity(on_grid),
        _velocity_against_position(on_grid),
        _tilt_against_acceleration(on_grid),
        _force_against_acceleration(on_grid),
        _clocks(on_grid),
    ]
    return tuple(finding for finding in contradictions if finding is not None)


def force_in_the_world(streams: Sequence[Stream]) -> Contradiction | None:
    """Specific force along the axes of the world, whose agreement with the motion tells nothing of other axes."""
    used = [stream for stream in streams if stream.name in ("attitude", "specific_force")]
    grid = _grid(used)
    return _force_against_tilt({stream.name: resample(stream, grid) for stream in used})


def _grid(streams: list[Stream]) -> Floats:
    spanning = spanning_streams(streams)
    start = min((float(stream.time[0]) for stream in spanning), default=0.0)
    end = max((float(stream.time[-1]) for stream in spanning), default=0.0)
    count = min(int((end - start) * _GRID_RATE) + 1, _MAX_ROWS)
    return np.asarray(start + np.arange(count) / _GRID_RATE)


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
    attitude, rate = on_grid["attitude"], _mean(on_grid["rate"])
    turned = _turned(attitude)
    short = np.linalg.norm(turned, axis=1, keepdims=True) < 1.5  # a longer turn is no rotation vector's rate
    pair = both(np.where(short, turned, np.nan) * (_GRID_RATE / _SPAN), rate)
    if pair is None:
        return None
    turning, rate = pair
    speed = rms(turning)
    if speed < _MIN_RATE:
        return None
    ratio = rms(rate) / speed
    if 0.5 * _DEGREES < ratio < 2 * _DEGREES:
        return Contradiction(
            "rates_in_degrees",
            f"the body rates are {ratio:.0f} times those by which the attitude turns: they are in deg/s. Wanted rad/s.",
        )
    agreeing = agreement(turning, rate)
    if agreeing > AGREEMENT and not may_be_one_size(ratio, agreeing) and not _clips(on_grid["rate"]):
        return Contradiction(
            "rate_unit",
            f"the body rates are {ratio:.2f} times those by which the attitude turns. Wanted rad/s; check the scale.",
        )
    for axis in range(3):
        if is_opposite(turning[:, axis], rate[:, axis], _MIN_RATE):
            return Contradiction(
                "rate_frame",
                f"the body rate about {'xyz'[axis]} has the opposite sign of the attitude's turning: they are not in "
                "the same axes (FRD and FLU?), or the attitude is world to body. Wanted both in body FLU, w first.",
            )
    exchanged = exchanged_axes(turning, rate, _MIN_RATE)
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
        clear = rms(turning[:, axis])
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
    if any(SAME_SIZE[0] < size / needed < SAME_SIZE[1] for needed in (GRAVITY, _needed_force(on_grid)) if needed):
        return None
    if SAME_SIZE[0] < size < SAME_SIZE[1]:
        return Contradiction("force_in_g", f"the specific force is {size:.2f} on average: it is in g. Wanted m/s^2.")
    if size < SAME_SIZE[0]:
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
    gained = _change(on_grid["velocity"])
    gained = gained[np.isfinite(gained).all(axis=1)]
    if len(gained) < 20:
        return 0.0
    return float(np.linalg.norm(np.median(gained, axis=0) + np.array([0.0, 0.0, GRAVITY])))


def _velocity_against_position(on_grid: dict[str, Floats]) -> Contradiction | None:
    if not {"position", "velocity"} <= on_grid.keys():
        return None
    pair = both(_change(on_grid["position"]), _mean(on_grid["velocity"]))
    if pair is None:
        return None
    speed = np.linalg.norm(pair[0], axis=1)
    usual = speed < max(50.0, 20.0 * float(np.median(speed)))  # an estimator's reset is no motion
    moved, velocity = (values[usual] for values in pair)
    unit = _unit_of_position(moved, velocity)
    if unit is not None:
        return unit
    for axis in range(3):
        if is_opposite(moved[:, axis], velocity[:, axis], _MIN_SPEED, _ERROR_OF_SPEED):
            return Contradiction(
                "velocity_frame",
                f"the velocity along {'xyz'[axis]} has the opposite sign of the position's change: they are not in the "
                "same axes (NED and ENU?). Wanted both in ENU.",
            )
    exchanged = exchanged_axes(moved, velocity, _MIN_SPEED)
    if exchanged:
        return Contradiction(
            "velocity_frame",
            f"the velocity is along other axes than the position's change ({exchanged}). Wanted both in ENU; put the "
            "columns in order.",
        )
    return None


def _unit_of_position(moved: Floats, velocity: Floats) -> Contradiction | None:
    """The change of position and the velocity must be of one size. Both: (n, 3) m/s."""
    moved, velocity = moved - np.median(moved, axis=0), velocity - np.median(velocity, axis=0)
    if rms(velocity) < _MIN_SPEED or rms(moved) == 0.0:
        return None
    ratio, agreeing = rms(moved) / rms(velocity), agreement(moved, velocity)
    if agreeing < AGREEMENT or may_be_one_size(ratio, agreeing):
        return None
    return Contradiction(
        "position_unit",
        f"the position changes by {ratio:.3g} times the velocity. Wanted m and m/s; convert them, or give a column "
        "mapping with their units.",
    )


def _tilt_against_acceleration(on_grid: dict[str, Floats]) -> Contradiction | None:
    """Thrust acts along body z: a multirotor that tilts to the east accelerates east."""
    if not {"attitude", "velocity"} <= on_grid.keys():
        return None
    thrust_direction = _mean(GRAVITY * quaternion.rotate(on_grid["attitude"], np.array([0.0, 0.0, 1.0])))
    pair = both(_change(on_grid["velocity"]), thrust_direction)
    if pair is None:
        return None
    a, b = (values[:, :2] for values in pair)
    if min(rms(a), rms(b)) < _MIN_ACCELERATION:
        return None
    agreeing = agreement(a, b)
    exchanged = agreement(a, b[:, ::-1])
    if agreeing < _NO_AGREEMENT and exchanged > AGREEMENT:
        return Contradiction(
            "attitude_frame",
            f"the vehicle accelerates along x where its thrust tilts along y (agreement {agreeing:.2f}, exchanged "
            f"{exchanged:.2f}): attitude and velocity are not in the same axes, as NED labelled as ENU. Wanted ENU and "
            "FLU; convert them, or give a column mapping.",
        )
    if agreeing > -AGREEMENT:
        return None
    return Contradiction(
        "attitude_frame",
        f"the vehicle accelerates away from where its thrust points (agreement {agreeing:.2f}): attitude and velocity "
        "are not in the same axes, as NED labelled as ENU. Wanted ENU and FLU; convert them, or give a column mapping.",
    )


def _force_against_acceleration(on_grid: dict[str, Floats]) -> Contradiction | None:
    """Vertical acceleration agrees between accelerometer and velocity."""
    if not {"attitude", "velocity", "specific_force"} <= on_grid.keys():
        return None
    measured = _mean(quaternion.rotate(on_grid["attitude"], on_grid["specific_force"])[:, 2:] - GRAVITY)
    pair = both(_change(on_grid["velocity"][:, 2:]), measured)
    if pair is None:
        return None
    a, b = pair[0], pair[1] - np.median(pair[1])
    if min(rms(a), rms(b)) < _MIN_ACCELERATION or agreement(a, b) > -AGREEMENT:
        return None
    return Contradiction(
        "velocity_frame",
        f"the velocity along z falls while the specific force exceeds gravity (agreement {agreement(a, b):.2f}): "
        "position and velocity are NED labelled as ENU. Wanted z up; convert them, or give a column mapping.",
    )


def _force_against_tilt(on_grid: dict[str, Floats]) -> Contradiction | None:
    """Specific force is measured along body axes, and shows nothing there of the thrust's horizontal part."""
    if not {"attitude", "specific_force"} <= on_grid.keys():
        return None
    force = on_grid["specific_force"]
    size = np.linalg.norm(force, axis=1, keepdims=True)
    tilted = _mean(size * quaternion.rotate(on_grid["attitude"], np.array([0.0, 0.0, 1.0])))[:, :2]
    pair = both(_mean(force)[:, :2], tilted)
    if pair is None:
        return None
    a, b = (values - np.median(values, axis=0) for values in pair)
    if rms(b) < _MIN_TILT_FORCE or not SAME_SIZE[0] < rms(a) / rms(b) < SAME_SIZE[1]:
        return None
    if agreement(a, b) < _WORLD_AXES:
        return None
    return Contradiction(
        "force_frame",
        "the specific force along x and y is that of the thrust's tilt in the world (agreement "
        f"{agreement(a, b):.2f}): it is in world axes. Wanted body FLU, where an accelerometer measures; rotate it "
        "back by the attitude.",
    )


def _clocks(on_grid: dict[str, Floats]) -> Contradiction | None:
    """Streams of one motion must show it at one time, whose size may be constant as on a circle."""
    pairs: list[tuple[str, Floats, Floats]] = []
    if {"attitude", "rate"} <= on_grid.keys():
        turning = _turned(on_grid["attitude"]) * (_GRID_RATE / _SPAN)
        pairs.append(("the body rates are", turning, _mean(on_grid["rate"])))
    if {"position", "velocity"} <= on_grid.keys():
        pairs.append(("the velocity is", _change(on_grid["position"]), _mean(on_grid["velocity"])))
    if {"attitude", "velocity", "specific_force"} <= on_grid.keys():
        world = quaternion.rotate(on_grid["attitude"], on_grid["specific_force"]) - np.array([0.0, 0.0, GRAVITY])
        gained = _change(on_grid["velocity"])
        pairs.append(("the accelerometer's clock, or the attitude's, is", gained, _mean(world)))
    for name, one, other in pairs:
        steps, gained_agreement = offset(one, other, round(_MAX_SHIFT * _GRID_RATE), _MIN_RATE)
        seconds = steps / _GRID_RATE
        if abs(seconds) >= _CLEAR_SHIFT and gained_agreement > _BETTER:
            late = "late" if seconds > 0 else "early"
            return Contradiction(
                "clock",
                f"{name} {abs(seconds):.2f} s {late} against the rest of the motion. Wanted one clock; stamp samples "
                "when they are measured, or shift the columns.",
            )
    return None


def _turned(attitude: Floats) -> Floats:
    """(n - 10, 3) rotation vectors, rad, by which an attitude (n, 4) turns over 0.2 s."""
    return quaternion.logarithm(quaternion.multiply(quaternion.conjugate(attitude[:-_SPAN]), attitude[_SPAN:]))


def _change(values: Floats) -> Floats:
    """(n - 10, k) change of values (n, k) over 0.2 s, per s."""
    return (values[_SPAN:] - values[:-_SPAN]) * (_GRID_RATE / _SPAN)


def _mean(values: Floats) -> Floats:
    """(n - 10, k) mean of values (n, k) over 0.2 s, by the trapezium rule."""
    steps = 0.5 * (values[1:] + values[:-1])
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(np.nan_to_num(steps, nan=0.0), axis=0)])
    gaps = np.concatenate([[0], np.cumsum(~np.isfinite(steps).all(axis=1))])
    mean = (sums[_SPAN:] - sums[:-_SPAN]) / _SPAN
    return np.where((gaps[_SPAN:] - gaps[:-_SPAN])[:, None] > 0, np.nan, mean)
