"""Errors of a vehicle's estimate by the kind of its estimator: none, those of motion capture, or those of PX4's EKF.

PX4's were measured against the ground truth of its own simulation (SITL, SIH quadrotor, GNSS and barometer with PX4's
default noise); `benchmarks/px4_estimate.py` compares them with what the mock makes of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynamics.arrays import Floats
from sitl_mock.vehicle.sensors import WANDER_DAMPING, SensorErrors, Vector3

Estimator = Literal["px4", "mocap", "perfect"]
DEAD_RECKONING_BIAS = 0.15  # m/s^2, the size of PX4's bias estimates' own errors
NO_AIDING_TIME = 5.0  # s, EKF2_NOAID_TOUT
CORRELATION_PHASE = 1.69  # frequency x time after which a smooth error's correlation is 1/e, at WANDER_DAMPING


@dataclass(frozen=True)
class Wander:
    """Errors of an estimate that come and go within seconds, and offsets that drift over minutes.

    World axes ENU, standard deviations of position (m), velocity (m/s) and rotation (rad); all zero for none.

    position, velocity, rotation: smooth errors in flight.
    position_time, velocity_time, rotation_time: until their correlation has fallen to 1/e, s.
    rest: share of the smooth errors of velocity while the rotors stand still.
    position_offset, rotation_offset: constant within seconds.
    offset_time: correlation time of the offsets, s.
    accelerometer_bias, gyro_bias: of the filter's bias estimates, which its inertial samples are freed of, m/s^2,
        rad/s.
    bias_time: correlation time of those, s.
    inertial_time: until the filter has forgotten what it integrates of the accelerometer's noise into climb rate and
        height, s; zeros where it does not. While the rotors turn on the ground this is most of the errors' growth.
    """

    position: Vector3 = (0.0, 0.0, 0.0)
    velocity: Vector3 = (0.0, 0.0, 0.0)
    rotation: Vector3 = (0.0, 0.0, 0.0)
    position_time: Vector3 = (1.0, 1.0, 1.0)
    velocity_time: Vector3 = (1.0, 1.0, 1.0)
    rotation_time: Vector3 = (1.0, 1.0, 1.0)
    rest: Vector3 = (1.0, 1.0, 1.0)
    position_offset: Vector3 = (0.0, 0.0, 0.0)
    rotation_offset: Vector3 = (0.0, 0.0, 0.0)
    offset_time: float = 1.0
    accelerometer_bias: Vector3 = (0.0, 0.0, 0.0)
    gyro_bias: Vector3 = (0.0, 0.0, 0.0)
    bias_time: float = 1.0
    inertial_time: tuple[float, float] = (0.0, 0.0)

    @property
    def spread(self) -> Floats:
        """(9,) standard deviations of the smooth errors in flight."""
        return np.array([*self.position, *self.velocity, *self.rotation])

    @property
    def frequency(self) -> Floats:
        """(9,) natural frequencies of the smooth errors, rad/s."""
        return CORRELATION_PHASE / np.array([*self.position_time, *self.velocity_time, *self.rotation_time])

    @property
    def share_at_rest(self) -> Floats:
        """(9,) of the smooth errors."""
        return np.array([*np.ones(3), *self.rest, *np.ones(3)])

    def constants(self) -> dict[str, Floats]:
        """The constants of the compiled step."""
        return {
            "wander_frequency": self.frequency,
            "wander_noise": self.spread * np.sqrt(4 * WANDER_DAMPING * self.frequency**3),
            "wander_rest": self.share_at_rest,
            "inertial_forgetting": np.array([1.0 / time if time else 0.0 for time in self.inertial_time]),
        }


class Drift:
    """The part of a `Wander` that takes minutes: offsets of the estimate and biases, drawn anew now and then.

    bias: (6,) of accelerometer and gyro.
    without_gnss: whether horizontal velocity and position are integrated from the accelerometer alone.
    """

    def __init__(self, wander: Wander, random: np.random.Generator, height_error: float | None = None) -> None:
        """height_error: of the estimate at the start, m; None for one by chance."""
        self._spread = np.array([*wander.position_offset, 0.0, 0.0, 0.0, *wander.rotation_offset])
        self._bias_spread = np.array([*wander.accelerometer_bias, *wander.gyro_bias])
        self._times = wander.offset_time, wander.bias_time
        self._random = random
        self._wandered: Floats = self._spread * random.standard_normal(9)
        self._mean = np.zeros(9)
        if height_error is not None:
            self._wandered[2] = self._mean[2] = height_error
        self._dead_reckoned = np.zeros(9)
        self._acceleration = np.zeros(2)  # false one while dead reckoning, m/s^2
        self.bias: Floats = np.zeros(6)
        self.without_gnss = False

    @property
    def offset(self) -> Floats:
        """(9,) of position, velocity and rotation."""
        return self._wandered + self._dead_reckoned

    def advance(self, duration: float) -> None:
        """Draw both after a duration, s."""
        share, bias_share = (math.exp(-duration / time) for time in self._times)
        step = math.sqrt(1 - share**2) * self._spread * self._random.standard_normal(9)
        self._wandered = self._mean + share * (self._wandered - self._mean) + step
        step = math.sqrt(1 - bias_share**2) * self._bias_spread * self._random.standard_normal(6)
        self.bias = bias_share * self.bias + step
        if self.without_gnss:
            self._dead_reckoned[0:2] += (self._dead_reckoned[3:5] + 0.5 * self._acceleration * duration) * duration
            self._dead_reckoned[3:5] += self._acceleration * duration

    def lose_gnss(self) -> None:
        """Let horizontal velocity and position drift off."""
        heading = self._random.uniform(0.0, 2 * math.pi)
        self._acceleration = DEAD_RECKONING_BIAS * np.array([math.cos(heading), math.sin(heading)])
        self.without_gnss = True

    def regain_gnss(self) -> None:
        """Reset velocity and position to what GNSS measures."""
        self._dead_reckoned = np.zeros(9)
        self.without_gnss = False


def at_rest(wander: Wander, random: np.random.Generator) -> tuple[Floats, Floats]:
    """Smooth errors of a vehicle that has stood for a while, and their rates. (9,) each."""
    spread = wander.spread * wander.share_at_rest
    return spread * random.standard_normal(9), spread * wander.frequency * random.standard_normal(9)


PX4_SENSORS = SensorErrors(
    gyro=(0.14, 0.07, 0.03),
    accelerometer=(0.5, 1.7, 1.4),
    gyro_at_rest=0.01,
    accelerometer_at_rest=0.1,
    sample_period=0.004,
    gyro_bias=0.0,
    accelerometer_bias=0.0,
    position=0.0,
    velocity=0.04,
    velocity_time=0.4,
    tilt=math.radians(0.15),
    yaw=math.radians(0.2),
    attitude_time=0.5,
    delay=0.0,
    estimate_period=0.008,
)
PX4_WANDER = Wander(  # vertically less than measured by what `inertial_time` adds: 0.15 m and 0.10 m/s
    position=(0.11, 0.15, 0.19),
    velocity=(0.18, 0.23, 0.10),
    rotation=(math.radians(0.75), math.radians(0.63), math.radians(0.59)),
    position_time=(3.1, 3.0, 4.0),
    velocity_time=(2.7, 2.6, 2.7),
    rotation_time=(2.5, 2.9, 3.8),
    rest=(0.8, 0.3, 0.77),
    position_offset=(0.10, 0.20, 0.42),
    rotation_offset=(math.radians(0.5), math.radians(0.4), math.radians(0.35)),
    offset_time=230.0,
    accelerometer_bias=(0.15, 0.15, 0.15),
    gyro_bias=(0.001, 0.001, 0.001),
    bias_time=30.0,
    inertial_time=(2.5, 2.0),
)
ERRORS: dict[Estimator, tuple[SensorErrors, Wander]] = {
    "px4": (PX4_SENSORS, PX4_WANDER),
    "mocap": (SensorErrors(), Wander()),
    "perfect": (SensorErrors().without_noise(), Wander()),
}
