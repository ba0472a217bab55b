"""The sensors of a RotorPy vehicle: noise, resolution, biases, clocks that disagree, and their faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from dynamics import quaternion
from dynamics.vehicle import EffectUse
from flights import Flight
from flights.log import Log, Provenance, Stream

Floats = NDArray[np.float64]

RATE = 100.0  # Hz, of the log
EXTRA = 0.2  # s that are flown before and after the log, for clocks that are off
WANDER, WANDER_TIME = (
    {"position": 5e-4, "velocity": 6e-3, "tilt": 1e-3},
    0.05,
)  # m, m/s, rad of the pose's own filter; s
NOISE = {"position": 3e-4, "velocity": 2.2e-3, "tilt": 8e-4, "gyro": 0.008, "accelerometer": 0.2, "rotor_speed": 1.0}
RESOLUTION = {"position": 1e-4, "velocity": 1e-3, "attitude": 1e-4, "gyro": 1e-3, "accelerometer": 5e-3}
SPEED_RESOLUTION = 10 * np.pi / 30  # ten turns a minute, rad/s
CLOCK_OFFSET = (0.001, 0.002)  # s by which the pose is early or late
GYRO_BIAS, IMU_BIAS = 0.003, 0.02  # rad/s, m/s^2


@dataclass(frozen=True)
class Sensors:
    """What one flight's sensors get wrong. noise: factor on `NOISE`. pose_age: s. speed_gain: (rotors,)."""

    noise: float
    pose_age: float
    gyro_bias: Floats
    imu_bias: Floats
    speed_gain: Floats

    @classmethod
    def drawn(cls, noise: float, random: np.random.Generator, faults: Sequence[EffectUse] = ()) -> Sensors:
        """The sensors of a flight, with faults that all flights have."""
        age = float(random.uniform(*CLOCK_OFFSET) * random.choice([-1.0, 1.0]))
        gyro, imu = GYRO_BIAS * random.standard_normal(3), IMU_BIAS * random.standard_normal(3)
        gain = np.ones(4)
        for fault in faults:
            values = fault.parameters
            axes = np.array([values.get(axis, 0.0) for axis in "xyz"])
            if fault.name == "imu_bias":
                imu = imu + axes
            elif fault.name == "gyro_bias":
                gyro = gyro + axes
            elif fault.name == "time_delay":
                age += values["delay"]
            elif fault.name == "rotor_speed_fault":
                gain[fault.rotor or 0] = values["gain"]
        return cls(noise, age, gyro, imu, gain)


def as_flight(
    true: Mapping[str, Floats], sensors: Sensors, name: str, *, commands: bool, random: np.random.Generator
) -> Flight:
    """What the sensors log of a flight. true: rows by RotorPy's names on `time`, s, the log beginning at 0."""
    end = true["time"][-1] - EXTRA
    time = np.arange(round(end * RATE) + 1) / RATE

    def off(quantity: str, width: int = 3) -> Floats:
        slow = WANDER.get(quantity, 0.0) * wandering(len(time), 1 / RATE / WANDER_TIME, random, width)
        return sensors.noise * (slow + NOISE[quantity] * random.standard_normal((len(time), width)))

    def smooth(key: str, at: Floats) -> Floats:
        return np.asarray(CubicSpline(true["time"], true[key])(at))

    then = time - sensors.pose_age
    turned = quaternion.normalise(np.roll(smooth("q", then), 1, axis=1))  # RotorPy's are w last
    attitude = quaternion.multiply(turned, quaternion.exponential(off("tilt")))
    motors = true["command"].shape[1]
    if commands:
        row = np.searchsorted(true["time"], time + 1e-9, side="right") - 1
        rotors = {"rotor_speed_command": true["command"][row]}  # held between two steps
    else:
        speed = (smooth("rotor_speeds", time) + off("rotor_speed", motors)) * sensors.speed_gain[:motors]
        rotors = {"rotor_speed": _rounded(speed, SPEED_RESOLUTION)}
    quantities = {
        "position": _rounded(smooth("x", then) + off("position"), RESOLUTION["position"]),
        "velocity": _rounded(smooth("v", then) + off("velocity"), RESOLUTION["velocity"]),
        "attitude": _rounded(np.asarray(attitude), RESOLUTION["attitude"]),
        "rate": _rounded(smooth("w", time) + off("gyro") + sensors.gyro_bias, RESOLUTION["gyro"]),
        "specific_force": _rounded(
            smooth("force", time) + off("accelerometer") + sensors.imu_bias, RESOLUTION["accelerometer"]
        ),
        **rotors,
    }
    streams = tuple(Stream(quantity, time, values, "rotorpy") for quantity, values in quantities.items())
    return Flight.from_log(Log(streams, Provenance(name, "", "simulated flight, measured", "rotorpy")))


def wandering(steps: int, step: float, random: np.random.Generator, width: int) -> Floats:
    """(steps, width) of first-order coloured noise with unit variance. step: over its correlation time."""
    keep = np.exp(-step)
    white = random.standard_normal((steps, width))
    white[0] /= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], white, axis=0))


def _rounded(values: Floats, step: float) -> Floats:
    return np.asarray(np.round(values / step) * step)
