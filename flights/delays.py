"""How late each stream's stamps are against the gyro's, with an interval, and their removal.

A value stamped t that was true at t - d is late by d. Attitude is compared with the gyro, velocity with the rotated
accelerometer, position with velocity, measured rotor speeds with the forces and torques that they make. Commands have
a response time instead, motor lag included, which is physics and never removed.

Each comparison leaves gains, biases and rotor constants free; see `flights.delay_fit`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from flights import filters
from flights.alignment import resample
from flights.delay_fit import Band, fit_delay
from flights.exclusion import Exclusion
from flights.log import Floats, Log, Stream
from flights.quantities import ROTORS

GRID_RATE = 200.0  # Hz of the comparisons
CUTOFF = 10.0  # Hz, or a quarter of the slowest rate
LOWEST = 0.5  # Hz: slower differences are biases
POSITION_BAND = (0.05, 10.0)  # Hz: nothing but noise is between position and velocity
ROTOR_BAND = (4.0, 15.0)  # Hz: slower forces are drag, inflow and gusts
# s within which controllers answer gusts, by their rotors, and noise of the estimate, by their motion; by the seeds for
# calibration of benchmarks/delay_estimation.py
ROTOR_LOOP, VELOCITY_LOOP = 0.03, 0.01
LARGEST_REACH = 0.008  # s of half an interval; a delay known less well than this is told and not removed


@dataclass(frozen=True)
class Delay:
    """One stream against another. seconds: by which its stamps are late. low, high: 95 % interval, s.

    is_response: the time constant of the lag by which rotors follow a command, rather than a clock's error.
    seconds_compared: of flight it rests on.
    """

    stream: str
    against: str
    seconds: float
    std: float
    low: float
    high: float
    is_response: bool
    seconds_compared: float

    @property
    def is_known(self) -> bool:
        """Whether the flight moved enough to tell it."""
        return self.high - self.low <= 2 * LARGEST_REACH

    def __str__(self) -> str:
        word = "is followed with a lag of" if self.is_response else "late by"
        return (
            f"{self.stream} {word} {1e3 * self.seconds:.1f} ms ({1e3 * self.low:.1f} to {1e3 * self.high:.1f}) "
            f"against {self.against}"
        )


def estimate_delays(log: Log, *, exclusions: Sequence[Exclusion] = ()) -> tuple[Delay, ...]:
    """Every delay that the log's streams can tell. exclusions: stretches to leave out, of the log's time."""
    frame = _Frame.of(log, exclusions)
    if frame is None:
        return ()
    attitude = _attitude(frame)
    late = attitude.seconds if attitude is not None and attitude.is_known else 0.0
    velocity = _velocity(frame, late)
    later = velocity.seconds if velocity is not None and velocity.is_known else 0.0
    found = (attitude, velocity, _position(frame), *_rotors(frame, late, later))
    return tuple(delay for delay in found if delay is not None)


def removable(delays: Sequence[Delay]) -> dict[str, float]:
    """What to take off each stream's stamps, s: known errors of clocks, position's by way of velocity."""
    known = {delay.stream: delay.seconds for delay in delays if delay.is_known and not delay.is_response}
    if "position" in known:
        known["position"] += known.get("velocity", 0.0)
    return known


def remove_delays(log: Log, delays: Sequence[Delay]) -> Log:
    """The log with the stamps of late streams put right."""
    late = removable(delays)
    streams = tuple(
        Stream(stream.name, stream.time - late[stream.name], stream.values, stream.source)
        if stream.name in late
        else stream
        for stream in log.streams
    )
    return replace(log, streams=streams)


@dataclass(frozen=True, eq=False)
class _Frame:
    """The log's streams on the grid of the comparisons. usable: (n,) rows outside of exclusions."""

    time: Floats
    rate: float
    streams: dict[str, Stream]
    usable: NDArray[np.bool_]

    @classmethod
    def of(cls, log: Log, exclusions: Sequence[Exclusion]) -> _Frame | None:
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
        """A stream's values at the grid's times, its stamps put right by `late` seconds."""
        stream = self.streams.get(name)
        return None if stream is None else resample(stream, self.time + late)

    def band(self, *names: str, band: Band = (LOWEST, CUTOFF)) -> Band:
        """The frequencies that streams can be compared at, Hz."""
        return band[0], min(band[1], *(0.25 * self.streams[name].rate for name in names))


def _attitude(frame: _Frame) -> Delay | None:
    attitude, rate = frame.get("attitude"), frame.get("rate")
    if attitude is None or rate is None:
        return None
    turned = quaternion.logarithm(quaternion.multiply(quaternion.conjugate(attitude[:-2]), attitude[2:]))
    turning = np.full_like(rate, np.nan)
    turning[1:-1] = turned * (0.5 * frame.rate)
    return _compare(frame, turning, rate, "attitude", "rate", frame.band("attitude", "rate"))


def _velocity(frame: _Frame, attitude_late: float) -> Delay | None:
    velocity, force = frame.get("velocity"), frame.get("specific_force")
    attitude = frame.get("attitude", late=attitude_late)
    if velocity is None or force is None or attitude is None:
        return None
    felt = quaternion.rotate(attitude, force)
    band = frame.band("velocity", "attitude", "specific_force")
    return _compare(frame, filters.derivative(velocity, 1 / frame.rate), felt, "velocity", "specific_force", band)


def _position(frame: _Frame) -> Delay | None:
    position, velocity = frame.get("position"), frame.get("velocity")
    if position is None or velocity is None:
        return None
    band = frame.band("position", "velocity", band=POSITION_BAND)
    return _compare(frame, filters.derivative(position, 1 / frame.rate), velocity, "position", "velocity", band)


def _rotors(frame: _Frame, attitude_late: float, velocity_late: float) -> tuple[Delay | None, ...]:
    rate, force = frame.get("rate"), frame.get("specific_force")
    if rate is None:
        return ()
    answer, against = filters.derivative(rate, 1 / frame.rate), "angular acceleration"
    if force is not None:
        answer, against = np.hstack([answer, force[:, 2:3]]), "IMU"
    beside = _beside_rotors(rate, frame.get("velocity", late=velocity_late), frame.get("attitude", late=attitude_late))
    found = []
    for name in ("rotor_speed", "rotor_speed_command", "rotor_thrust_command", "rotor_command"):
        values = frame.get(name)
        if values is None:
            continue
        # a speed acts by its square; the curve of a signal is not known: its square beside itself
        drive = values if name == "rotor_thrust_command" else values**2
        drive = np.hstack([values, drive]) if name == "rotor_command" else drive
        band = frame.band(name, "rate", band=ROTOR_BAND)
        lags = name != "rotor_speed"
        delay = _compare(frame, answer, drive, name, against, band, beside=beside, lags=lags)
        if delay is not None and not lags:  # the IMU is what is compared: it is late when the rotors are early
            delay = replace(delay, seconds=-delay.seconds, low=-delay.high, high=-delay.low)
        found.append(delay)
    return tuple(found)


def _beside_rotors(rate: Floats, velocity: Floats | None, attitude: Floats | None) -> Floats:
    """What turns and lifts a vehicle besides its rotors: damping, gyroscopic moments, airspeed."""
    products = rate[:, [1, 2, 0]] * rate[:, [2, 0, 1]]
    if velocity is None or attitude is None:
        return np.hstack([rate, products])
    return np.hstack([rate, products, quaternion.rotate_inverse(attitude, velocity)])


def _compare(
    frame: _Frame, answer: Floats, drive: Floats, name: str, against: str, band: Band,
    *, beside: Floats | None = None, lags: bool = False,
) -> Delay | None:  # fmt: skip
    beside = np.empty((len(answer), 0)) if beside is None else beside
    paired = name not in ROTORS
    closed_loop = VELOCITY_LOOP if name == "velocity" else 0.0 if paired else ROTOR_LOOP
    fit = fit_delay(
        answer, drive, beside, frame.rate, band, frame.usable,
        paired=paired, lags=lags, closed_loop=closed_loop,
    )  # fmt: skip
    if fit is None:
        return None
    low, high = fit.seconds - fit.reach, fit.seconds + fit.reach
    return Delay(name, against, fit.seconds, fit.std, low, high, lags, fit.compared)
