"""Delays of streams against the gyro's clock, with intervals, and their removal.

A value stamped t that was true at t - d is late by d. Attitude is compared with the gyro, velocity with the rotated
accelerometer, position with velocity, measured rotor speeds with the forces and torques that they make. Commands have
a response time instead, which belongs to the vehicle and is never removed: of thrust and of angular acceleration each,
as a first-order lag and as a pure delay, with the share that either explains.

Each comparison leaves gains, biases and rotor constants free; see `flights.delay_fit`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.arrays import Floats
from flights import filters
from flights.alignment import resample
from flights.delay_fit import Band, ThrustCurve, fit_delay
from flights.exclusion import Exclusion
from flights.log import Log, Stream
from flights.quantities import ROTORS

GRID_RATE = 200.0  # Hz of the comparisons
CUTOFF = 10.0  # Hz, or a quarter of the slowest rate
MIN_FREQUENCY = 0.5  # Hz: slower differences are biases
VELOCITY_BAND = (0.2, 5.0)  # Hz: slower is tilt, faster the controller's answer to the estimate's noise
POSITION_BAND = (0.05, 10.0)  # Hz: nothing but noise is between position and velocity
ROTOR_BAND = (4.0, 15.0)  # Hz: slower forces are drag, inflow and gusts
RESPONSE_BAND = (0.05, 10.0)  # Hz: where a vehicle moves; slower is its battery
MIN_COMMANDS = 20.0  # Hz at which commands must be logged for their response to be estimated
# s within which controllers answer gusts, by their rotors, and noise of the estimate, by their motion; by the seeds for
# calibration of benchmarks readers delays
ROTOR_LOOP, VELOCITY_LOOP = 0.03, 0.01
MAX_REACH = 0.008  # s of half an interval; a less certain delay is reported and not removed


@dataclass(frozen=True)
class Delay:
    """The delay of one stream against another.

    seconds: by which its stamps are late; of a lag its time constant.
    low, high: 95 % interval, s.
    kind: an error of a clock, or the response to a command as a first-order lag or a pure delay.
    seconds_compared: length of the flight that was compared.
    std: standard deviation, s.
    explained: share of the variance of the stream compared with, 0 to 1.
    """

    stream: str
    against: str
    seconds: float
    std: float
    low: float
    high: float
    kind: Literal["clock", "lag", "delay"]
    seconds_compared: float
    explained: float

    @property
    def is_response(self) -> bool:
        """Whether it is how a command is followed rather than an error of a clock."""
        return self.kind != "clock"

    @property
    def is_known(self) -> bool:
        """Whether the flight moved enough for a certain estimate."""
        return self.high - self.low <= 2 * MAX_REACH

    def __str__(self) -> str:
        value = f"{1e3 * self.seconds:.1f} ms ({1e3 * self.low:.1f} to {1e3 * self.high:.1f})"
        if self.kind == "clock":
            return f"{self.stream} late by {value} against {self.against}"
        word = "a lag" if self.kind == "lag" else "a pure delay"
        return f"{self.against} follows {self.stream} with {word} of {value}, which explains {self.explained:.0%} of it"


def estimate_delays(log: Log, *, exclusions: Sequence[Exclusion] = ()) -> tuple[Delay, ...]:
    """Every delay that the log's streams determine. exclusions: segments to leave out, of the log's time."""
    grid = _Grid.of(log, exclusions)
    if grid is None:
        return ()
    attitude = _attitude(grid)
    attitude_late = attitude.seconds if attitude is not None and attitude.is_known else 0.0
    velocity = _velocity(grid, attitude_late)
    velocity_late = velocity.seconds if velocity is not None and velocity.is_known else 0.0
    delays = (attitude, velocity, _position(grid), *_rotors(grid, attitude_late, velocity_late))
    return tuple(delay for delay in delays if delay is not None)


def removable(delays: Sequence[Delay]) -> dict[str, float]:
    """Seconds to subtract from each stream's stamps: certain errors of clocks, position's by way of velocity's."""
    seconds = {delay.stream: delay.seconds for delay in delays if delay.is_known and not delay.is_response}
    if "position" in seconds:
        seconds["position"] += seconds.get("velocity", 0.0)
    return seconds


def remove_delays(log: Log, delays: Sequence[Delay]) -> Log:
    """The log with the delays of its streams removed."""
    late = removable(delays)
    streams = tuple(
        Stream(stream.name, stream.time - late[stream.name], stream.values, stream.source)
        if stream.name in late
        else stream
        for stream in log.streams
    )
    return replace(log, streams=streams)


@dataclass(frozen=True, eq=False)
class _Grid:
    """The log's streams on the grid of the comparisons. usable: (n,) rows outside of exclusions."""

    time: Floats
    rate: float
    streams: dict[str, Stream]
    usable: NDArray[np.bool_]

    @classmethod
    def of(cls, log: Log, exclusions: Sequence[Exclusion]) -> _Grid | None:
        streams = {name: stream for name in log.names if (stream := log.stream(name)) is not None}
        if "rate" not in streams:
            return None
        gyro = streams["rate"]
        rate = min(GRID_RATE, max(50.0, 2 * gyro.rate))
        time = np.asarray(np.arange(gyro.time[0], gyro.time[-1], 1 / rate))
        usable = np.ones(len(time), dtype=bool)
        for item in exclusions:
            usable &= (time < item.start) | (time > item.stop)
        return cls(time, rate, streams, usable)

    def get(self, name: str, *, late: float = 0.0) -> Floats | None:
        """A stream's values at the grid's times, its stamps corrected by `late` seconds."""
        stream = self.streams.get(name)
        return None if stream is None else resample(stream, self.time + late)

    def band(self, *names: str, band: Band = (MIN_FREQUENCY, CUTOFF)) -> Band:
        """The frequencies that streams can be compared at, Hz."""
        return band[0], min(band[1], *(0.25 * self.streams[name].rate for name in names))


def _attitude(grid: _Grid) -> Delay | None:
    attitude, rate = grid.get("attitude"), grid.get("rate")
    if attitude is None or rate is None:
        return None
    turned = quaternion.logarithm(quaternion.multiply(quaternion.conjugate(attitude[:-2]), attitude[2:]))
    turning = np.full_like(rate, np.nan)
    turning[1:-1] = turned * (0.5 * grid.rate)
    return _compare(grid, turning, rate, "attitude", "rate", grid.band("attitude", "rate"))


def _velocity(grid: _Grid, attitude_late: float) -> Delay | None:
    velocity, force = grid.get("velocity"), grid.get("specific_force")
    attitude = grid.get("attitude", late=attitude_late)
    if velocity is None or force is None or attitude is None:
        return None
    force_world = quaternion.rotate(attitude, force)
    band = grid.band("velocity", "attitude", "specific_force", band=VELOCITY_BAND)
    return _compare(grid, filters.derivative(velocity, 1 / grid.rate), force_world, "velocity", "specific_force", band)


def _position(grid: _Grid) -> Delay | None:
    position, velocity = grid.get("position"), grid.get("velocity")
    if position is None or velocity is None:
        return None
    band = grid.band("position", "velocity", band=POSITION_BAND)
    return _compare(grid, filters.derivative(position, 1 / grid.rate), velocity, "position", "velocity", band)


def _rotors(grid: _Grid, attitude_late: float, velocity_late: float) -> tuple[Delay | None, ...]:
    rate, force = grid.get("rate"), grid.get("specific_force")
    if rate is None:
        return ()
    undelayed = _rotorless_regressors(
        rate, grid.get("velocity", late=velocity_late), grid.get("attitude", late=attitude_late)
    )
    answers = {"angular acceleration": filters.derivative(rate, 1 / grid.rate)}
    if force is not None:
        answers = {"thrust": force[:, 2:3], **answers}
    return (
        _rotor_clock(grid, answers, undelayed),
        *(delay for name in _CURVES for delay in _responses(grid, name, answers, undelayed)),
    )


def _rotor_clock(grid: _Grid, answers: Mapping[str, Floats], undelayed: Floats) -> Delay | None:
    speed = grid.get("rotor_speed")
    if speed is None:
        return None
    against = "IMU" if len(answers) > 1 else next(iter(answers))
    band = grid.band("rotor_speed", "rate", band=ROTOR_BAND)
    answer = np.hstack(list(answers.values()))
    delay = _compare(grid, answer, speed**2, "rotor_speed", against, band, undelayed=undelayed)
    if delay is None:
        return None
    # the IMU is what is compared: it is late when the rotors are early
    return replace(delay, seconds=-delay.seconds, low=-delay.high, high=-delay.low)


def _responses(grid: _Grid, name: str, answers: Mapping[str, Floats], undelayed: Floats) -> list[Delay | None]:
    """How thrust and angular acceleration follow a command, as a lag and as a delay each."""
    command = grid.get(name)
    if command is None or grid.streams[name].rate < MIN_COMMANDS:
        return []
    curve, band, delays = _CURVES[name], grid.band(name, "rate", band=RESPONSE_BAND), []
    for against, answer in answers.items():
        delays.append(_compare(grid, answer, command, name, against, band, undelayed=undelayed, lagged=curve))
        delays.append(_compare(grid, answer, curve(command), name, against, band, undelayed=undelayed))
    return delays


# A rotor's thrust by its command: the square of a speed; the curve of a signal is unknown, so that the signal and its
# square are both regressors.
_CURVES: Mapping[str, ThrustCurve] = {
    "rotor_speed_command": np.square,
    "rotor_thrust_command": np.asarray,
    "rotor_command": lambda values: np.hstack([values, values**2]),
}


def _rotorless_regressors(rate: Floats, velocity: Floats | None, attitude: Floats | None) -> Floats:
    """Regressors of forces and moments other than the rotors': damping, gyroscopic moments, airspeed."""
    products = rate[:, [1, 2, 0]] * rate[:, [2, 0, 1]]
    if velocity is None or attitude is None:
        return np.hstack([rate, products])
    return np.hstack([rate, products, quaternion.rotate_inverse(attitude, velocity)])


def _compare(
    grid: _Grid,
    answer: Floats,
    drive: Floats,
    name: str,
    against: str,
    band: Band,
    *,
    undelayed: Floats | None = None,
    lagged: ThrustCurve | None = None,
) -> Delay | None:
    undelayed = np.empty((len(answer), 0)) if undelayed is None else undelayed
    paired = name not in ROTORS
    closed_loop = VELOCITY_LOOP if name == "velocity" else 0.0 if paired else ROTOR_LOOP
    kind: Literal["clock", "lag", "delay"] = "clock" if name not in _CURVES else "delay" if lagged is None else "lag"
    fit = fit_delay(
        answer,
        drive,
        undelayed,
        grid.rate,
        band,
        grid.usable,
        paired=paired,
        lagged=lagged,
        whiten=kind == "clock",
        closed_loop=closed_loop,
    )
    if fit is None:
        return None
    low, high = fit.seconds - fit.reach, fit.seconds + fit.reach
    return Delay(name, against, fit.seconds, fit.std, low, high, kind, fit.compared, fit.explained)
