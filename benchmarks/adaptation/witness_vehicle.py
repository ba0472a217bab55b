"""A quadrotor that shares no formula with this project: a witness for what was tuned on its own simulator.

Written from textbooks (Mahony, Kumar and Corke, 2012; Stevens and Lewis, 2016) with numpy alone. What differs from the
mock's: thrust follows its command with a lag of its own, slower downwards than upwards, and grows with the command to
the power of 1.9; inertia and thrust are a few percent off the vehicle file's; rotors drag by the square root of their
thrust, the body by axis; thrust falls with the axial inflow; the air has slow gusts of second order; the rate loop runs
at 250 Hz; the estimate is late, and its velocity has an error that wanders, as where a filter's biases do.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

STEP = 0.004  # s
MASS, ARM, GRAVITY, AIR = 0.25, 0.076, 9.81, 1.2
INERTIA = np.array([6.3e-4, 6.1e-4, 1.02e-3])  # kg m^2; the vehicle file's are 5 % off
FULL_THRUST = 1.23  # N of a rotor at full command
EXPONENT = 1.9  # of thrust over the command
YAW_ARM = 0.0091  # m, reaction torque over thrust
UP, DOWN = 0.025, 0.04  # s, lags of thrust
ROTOR_DRAG = 0.0345  # N per (m/s and sqrt(N)): 0.43 m/s^2 per m/s in hover
BODY_AREA = np.array([0.004, 0.005, 0.011])  # m^2, drag coefficient times area, by body axis
INFLOW = 0.015  # share of thrust lost per m/s of axial inflow
PLACES = np.array([[ARM, ARM], [-ARM, ARM], [-ARM, -ARM], [ARM, -ARM]])  # m, forward and left
TURNS = np.array([1.0, -1.0, 1.0, -1.0])
RATE_GAIN, RATE_INTEGRAL = np.array([22.0, 22.0, 9.0]), np.array([25.0, 25.0, 8.0])  # 1/s, 1/s^2
DELAY = 4  # steps by which the estimate is late


class WitnessVehicle:
    """The vehicle, its rate loop and its estimator.

    wind: mean (3,) of the air, m/s. gust: standard deviation about it, m/s.
    """

    def __init__(self, place: Vector, *, wind: Vector, gust: float, seed: int) -> None:
        """place: (3,) m, where it hovers at the start."""
        self._random = np.random.default_rng(seed)
        self.wind, self.gust = wind, gust
        self.position, self.velocity = place.astype(float).copy(), np.zeros(3)
        self.attitude, self.rate = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
        self.thrust = np.full(4, MASS * GRAVITY / 4)
        self.steps = 0
        self._integral, self._gyro = np.zeros(3), np.zeros(3)
        self._gust_state = np.zeros((2, 3))
        self._velocity_error, self._position_error, self._tilt_error = np.zeros(3), np.zeros(3), np.zeros(3)
        self._accelerometer_bias = 0.05 * self._random.normal(size=3)
        self.force = np.array([0.0, 0.0, GRAVITY])  # specific, body
        self._past = [self._estimate()] * (DELAY + 1)

    @property
    def time(self) -> float:
        """s."""
        return self.steps * STEP

    @property
    def rotor_speed(self) -> Vector:
        """(4,) as ESCs report it, rad/s: of the thrust constant of the vehicle file, with a percent of error."""
        return np.asarray(np.sqrt(self.thrust / 3.994e-7) * (1 + 0.002 * self._random.normal(size=4)))

    @property
    def estimate(self) -> tuple[float, Vector]:
        """Time and state (13,) of the newest estimate: position, velocity, attitude w first, body rate."""
        return self.time - DELAY * STEP, self._past[0]

    @property
    def accelerometer(self) -> Vector:
        """(3,) specific force, body, m/s^2."""
        return np.asarray(self.force + self._accelerometer_bias + 0.25 * self._random.normal(size=3))

    def advance(self, rate: Vector, collective: float, seconds: float) -> None:
        """Follow body rates (3,) rad/s with a collective thrust, 0..1 of the command that PX4's curve takes."""
        for _ in range(round(seconds / STEP)):
            self._follow(rate, collective)

    def _follow(self, rate: Vector, collective: float) -> None:
        self._gyro += 0.6 * (self.rate + 0.01 * self._random.normal(size=3) - self._gyro)
        error = rate - self._gyro
        self._integral = np.clip(self._integral + STEP * RATE_INTEGRAL * error, -8.0, 8.0)
        torque = INERTIA * (RATE_GAIN * error + self._integral)
        command = np.clip(_mixed(collective * 4 * FULL_THRUST, torque) / FULL_THRUST, 0.0, 1.0)
        demanded = FULL_THRUST * command ** (EXPONENT / 2)  # the motor takes the root of the share of thrust
        lag = np.where(demanded > self.thrust, UP, DOWN)
        self.thrust += (1 - np.exp(-STEP / lag)) * (demanded - self.thrust)
        self._blow()
        self._integrate()
        self._err()
        self.steps += 1
        self._past = [*self._past[1:], self._estimate()]

    def _blow(self) -> None:
        speed, change = self._gust_state
        noise = self.gust * math.sqrt(4 * 0.7 * 0.8**3 / STEP) * self._random.normal(size=3)
        change += STEP * (noise - 2 * 0.7 * 0.8 * change - 0.8**2 * speed)
        speed += STEP * change

    def _integrate(self) -> None:
        x = np.concatenate([self.position, self.velocity, self.attitude, self.rate])
        k1 = self._slope(x)
        k2 = self._slope(x + STEP / 2 * k1)
        k3 = self._slope(x + STEP / 2 * k2)
        k4 = self._slope(x + STEP * k3)
        x = x + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self.position, self.velocity, self.rate = x[:3], x[3:6], x[10:]
        self.attitude = x[6:10] / math.sqrt(float(x[6:10] @ x[6:10]))

    def _slope(self, x: Vector) -> Vector:
        w, a, b, c = x[6:10].tolist()
        R = _rotation(w, a, b, c)
        air = R.T @ (x[3:6] - self.wind - self._gust_state[0])
        lift = self.thrust * (1 - INFLOW * air[2])
        drag = -ROTOR_DRAG * float(np.sqrt(np.maximum(self.thrust, 0.0)).sum()) * air * np.array([1.0, 1.0, 0.0])
        drag = drag - 0.5 * AIR * BODY_AREA * np.abs(air) * air
        self.force = (drag + np.array([0.0, 0.0, float(lift.sum())])) / MASS
        torque = np.array([PLACES[:, 1] @ lift, -PLACES[:, 0] @ lift, -YAW_ARM * (TURNS @ self.thrust)])
        p, q, r = x[10:].tolist()
        turning = (torque - np.cross(x[10:], INERTIA * x[10:])) / INERTIA
        spin = 0.5 * np.array(
            [-a * p - b * q - c * r, w * p + b * r - c * q, w * q + c * p - a * r, w * r + a * q - b * p]
        )
        return np.concatenate([x[3:6], R @ self.force - [0.0, 0.0, GRAVITY], spin, turning])

    def _err(self) -> None:
        """Let the estimate's errors wander."""
        normal = self._random.normal
        self._velocity_error += -STEP / 3.0 * self._velocity_error + 0.03 * math.sqrt(2 * STEP / 3.0) * normal(size=3)
        self._position_error += STEP * (self._velocity_error - self._position_error / 1.5)
        self._tilt_error += -STEP / 5.0 * self._tilt_error + 0.004 * math.sqrt(2 * STEP / 5.0) * normal(size=3)

    def _estimate(self) -> Vector:
        half = np.array([1.0, *(0.5 * self._tilt_error)])
        turned = _product(half / math.sqrt(float(half @ half)), self.attitude)
        jitter = 0.004 * self._random.normal(size=3)
        return np.concatenate(
            [self.position + self._position_error, self.velocity + self._velocity_error + jitter, turned, self._gyro]
        )


def _mixed(collective: float, torque: Vector) -> Vector:
    """(4,) thrust of the rotors, N; yaw gives way first where a rotor has no room."""
    level = collective / 4 + (PLACES[:, 1] * torque[0] - PLACES[:, 0] * torque[1]) / (4 * ARM**2)
    yaw = -TURNS * torque[2] / (4 * YAW_ARM)
    room = min(float(np.min(FULL_THRUST - level)), float(np.min(level)))
    largest = float(np.abs(yaw).max())
    return np.asarray(level + yaw * min(1.0, max(room, 0.0) / max(largest, 1e-9)))


def _rotation(w: float, x: float, y: float, z: float) -> Vector:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _product(left: Vector, right: Vector) -> Vector:
    a, b, c, d = left.tolist()
    w, x, y, z = right.tolist()
    return np.array(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )
