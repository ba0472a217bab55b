"""Errors of the vehicle's sensors and of its estimator."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics import symbolic as ca
from dynamics.effect import Expression, Values

WANDER_DAMPING = 0.65  # of the estimate's smooth errors
Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class SensorErrors:
    """Standard deviations of the errors of sensors and estimator; all zero for perfect ones.

    gyro: white, of a sample, rad/s; about all body axes or about each.
    accelerometer: white, of a sample, m/s^2; along all body axes or along each.
    gyro_at_rest, accelerometer_at_rest: the same while the rotors stand still; None for no difference.
    sample_period: time from one sample to the next, s.
    gyro_bias, accelerometer_bias: constant during a flight, drawn at its start.
    position, velocity, tilt, yaw: of the estimate, m, m/s, rad, rad; the velocity's error is integrated into the
        position's, as in any filter.
    position_time, velocity_time, attitude_time: correlation times of those, s.
    rotor_speed: white, rad/s.
    rotor_speed_step: resolution of the measured rotor speed, rad/s.
    delay: age of the estimate when it is read, s.
    estimate_period: time from one estimate to the next, s.
    imu_average: time over which an inertial sample is averaged, s: by trapezoids where samples are as far apart.
    """

    gyro: float | Vector3 = 0.02
    accelerometer: float | Vector3 = 0.3
    gyro_at_rest: float | None = None
    accelerometer_at_rest: float | None = None
    sample_period: float = 0.001
    gyro_bias: float = 0.001
    accelerometer_bias: float = 0.02
    position: float = 0.003
    position_time: float = 0.5
    velocity: float = 0.01
    velocity_time: float = 0.3
    tilt: float = 0.002
    yaw: float = 0.004
    attitude_time: float = 2.0
    rotor_speed: float = 1.0
    rotor_speed_step: float = 1.5
    delay: float = 0.010
    estimate_period: float = 0.001
    imu_average: float = 0.004

    def without_noise(self) -> SensorErrors:
        """Perfect sensors and estimator with the same delay."""
        return SensorErrors(
            gyro=0.0,
            accelerometer=0.0,
            gyro_bias=0.0,
            accelerometer_bias=0.0,
            position=0.0,
            velocity=0.0,
            tilt=0.0,
            yaw=0.0,
            rotor_speed=0.0,
            rotor_speed_step=0.0,
            delay=self.delay,
            estimate_period=self.estimate_period,
            imu_average=self.imu_average,
        )

    def constants(self, random: np.random.Generator) -> dict[str, NDArray[np.float64]]:
        """The constants of the compiled step; the biases of this flight are drawn here."""
        gyro, force = (np.broadcast_to(np.array(value), 3) for value in (self.gyro, self.accelerometer))
        return {
            "gyro_noise": gyro,
            "accelerometer_noise": force,
            "gyro_rest_noise": gyro if self.gyro_at_rest is None else np.full(3, self.gyro_at_rest),
            "accelerometer_rest_noise": (
                force if self.accelerometer_at_rest is None else np.full(3, self.accelerometer_at_rest)
            ),
            "gyro_bias": self.gyro_bias * random.standard_normal(3),
            "accelerometer_bias": self.accelerometer_bias * random.standard_normal(3),
            "estimate_noise": np.array([self.position] * 3 + [self.velocity] * 3 + [self.tilt, self.tilt, self.yaw]),
            "estimate_time": np.array([self.position_time] * 3 + [self.velocity_time] * 3 + [self.attitude_time] * 3),
            "rotor_speed_noise": np.array([self.rotor_speed]),
        }


def next_estimate_error(error: Expression, noise: Expression, constants: Values, dt: float) -> Expression:
    """Errors of position, velocity and attitude (a body rotation vector) after dt, a Gauss-Markov process. (9,)."""
    keep = ca.exp(-dt / constants["estimate_time"])
    correlated = keep * error + constants["estimate_noise"] * ca.sqrt(1 - keep**2) * noise
    return ca.vertcat(correlated[0:3] + dt * error[3:6], correlated[3:9])


def next_wander(
    error: Expression, rate: Expression, noise: Expression, constants: Values, dt: float
) -> tuple[Expression, Expression]:
    """Smooth errors and their rates after dt: Gauss-Markov processes of second order. (9,) each."""
    frequency = constants["wander_frequency"]
    damped = 2 * WANDER_DAMPING * frequency * rate + frequency**2 * error
    after = rate + dt * (constants["wander_noise"] * noise / dt**0.5 - damped)
    return error + dt * after, after


def next_inertial_error(error: Expression, noise: Expression, forgetting: Expression, dt: float) -> Expression:
    """Errors of climb rate and height after dt, as a filter integrates the accelerometer's noise. (2,) m/s, m.

    noise: along world z, m/s^2. forgetting: (2,) 1/s; a rate of zero is a filter that integrates none.
    """
    integrates = ca.if_else(forgetting > 0, 1.0, 0.0)
    change = integrates * ca.vertcat(noise, error[0]) - forgetting * error
    return error + dt * change


def quantised(value: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """The value at a resolution; a step of zero leaves it as it is."""
    return np.asarray(np.round(value / step) * step) if step > 0 and math.isfinite(step) else value
