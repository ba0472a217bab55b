"""A vehicle without a plant: perfect inner loops on a point mass, for tests of the mock's wire half."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynamics.arrays import Floats
from dynamics.quaternion import exponential, multiply, normalise, rotate
from sitl_mock.vehicle.vehicle_interface import BatteryState, ControlSetpoint, ImuSample, MotionState, Tuning

GRAVITY = np.array([0.0, 0.0, -9.81])


class KinematicVehicle:
    """Hovers at half thrust, follows rates and attitudes at once, comes to rest on the ground."""

    def __init__(self) -> None:
        self.time = 0.0
        self.position = np.zeros(3)
        self.velocity = np.zeros(3)
        self.attitude = np.array([1.0, 0.0, 0.0, 0.0])
        self.rate = np.zeros(3)
        self.thrust = 0.0
        self.armed = False
        self.setpoint = ControlSetpoint("idle")
        self.tuning = Tuning()
        self.held, self.has_position = False, True
        self.rotor_position = np.array([[0.1, 0.1, 0], [-0.1, 0.1, 0], [-0.1, -0.1, 0], [0.1, -0.1, 0]])

    @property
    def truth(self) -> MotionState:
        return MotionState(self.time, self.position, self.velocity, self.attitude, self.rate)

    @property
    def estimate(self) -> MotionState:
        return self.truth

    @property
    def imu(self) -> ImuSample:
        return ImuSample(self.time, np.array([0.0, 0.0, 9.81 * 2 * self.thrust]), self.rate)

    @property
    def rotor_speed(self) -> np.ndarray:
        return self.motor_signal * 1000.0

    @property
    def motor_signal(self) -> np.ndarray:
        return self.thrust * np.array([1.0, 1.01, 1.02, 1.03])

    @property
    def battery(self) -> BatteryState:
        return BatteryState(16.0, 4.0, 0.9)

    @property
    def on_ground(self) -> bool:
        return bool(self.position[2] <= 1e-6)

    @property
    def ground_force(self) -> float:
        return float(self.on_ground)

    def knock(self, rate_body: Floats) -> None:
        """A blow does not turn this vehicle."""

    def hold(self, held: bool) -> None:
        self.held = held

    def change(self, values: Mapping[str, float]) -> None:
        """Nothing: it has no model."""

    def use_gnss(self, available: bool) -> None:
        self.has_position = available

    def tune(self, tuning: Tuning) -> None:
        self.tuning = tuning

    def advance(self, setpoint: ControlSetpoint, armed: bool, duration: float) -> None:
        self.setpoint, self.armed = setpoint, armed
        self.time += duration
        self.rate = np.zeros(3)
        self.thrust = 0.0
        if armed:
            self._fly(setpoint, duration)
        acceleration = GRAVITY + rotate(self.attitude, np.array([0.0, 0.0, 9.81 * 2 * self.thrust]))
        if self.on_ground and acceleration[2] <= 0:
            self.velocity, self.position = np.zeros(3), self.position * np.array([1, 1, 0])
            return
        self.velocity = self.velocity + acceleration * duration
        self.position = self.position + self.velocity * duration
        if self.position[2] <= 0:
            self.position, self.velocity = self.position * np.array([1, 1, 0]), np.zeros(3)

    def _fly(self, setpoint: ControlSetpoint, duration: float) -> None:
        if setpoint.kind == "rates":
            self.rate = np.where(np.isfinite(setpoint.rate_body), setpoint.rate_body, 0.0)  # as PX4 leaves such alone
            self.attitude = normalise(multiply(self.attitude, exponential(self.rate * duration)))
            self.thrust = min(max(setpoint.thrust, 0.0), 1.0)
        elif setpoint.kind == "attitude":
            self.attitude = setpoint.attitude
            self.thrust = min(max(setpoint.thrust, 0.0), 1.0)
        elif setpoint.kind != "idle":
            self.attitude = np.array([1.0, 0.0, 0.0, 0.0])
            self.thrust = 0.5 + 0.05 * (self._climb(setpoint) - self.velocity[2])

    def _climb(self, setpoint: ControlSetpoint) -> float:
        if setpoint.kind == "hold" and np.isfinite(setpoint.position_world[2]):
            return float(np.clip(setpoint.position_world[2] - self.position[2], -1.0, 1.0))
        if setpoint.kind == "hold":
            return float(np.nan_to_num(setpoint.velocity_world[2]))
        return -0.7
