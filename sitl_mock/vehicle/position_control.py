"""The modes that fly by themselves (hold, land, return): a cascade from position to attitude and thrust.

The cascade and its limits are PX4's PositionControl with default parameters; ENU world, FLU body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, MotionState, Tuning

POSITION_GAIN = np.array([0.95, 0.95, 1.0])  # MPC_XY_P, MPC_Z_P, 1/s
VELOCITY_GAIN = np.array([1.8, 1.8, 4.0])  # MPC_XY_VEL_P_ACC, MPC_Z_VEL_P_ACC, 1/s
INTEGRAL_GAIN = np.array([0.4, 0.4, 2.0])  # MPC_XY_VEL_I_ACC, MPC_Z_VEL_I_ACC, 1/s^2
DAMPING_GAIN = np.array([0.2, 0.2, 0.0])  # MPC_XY_VEL_D_ACC, MPC_Z_VEL_D_ACC
CRUISE_SPEED, CLIMB_SPEED, DESCENT_SPEED = 5.0, 3.0, 1.5  # MPC_XY_CRUISE, MPC_Z_VEL_MAX_UP, MPC_Z_VEL_MAX_DN, m/s
TILT_MAX = math.radians(45.0)  # MPC_TILTMAX_AIR
THRUST_MIN, THRUST_MAX = 0.12, 1.0  # MPC_THR_MIN, MPC_THR_MAX
SLOW_FROM, SLOW_AT = 10.0, 5.0  # MPC_LAND_ALT1, MPC_LAND_ALT2: descent slows down between these heights, m
TAKE_OFF_SPEED = 0.2  # upward speed setpoint at which a landed vehicle takes off, m/s
ARRIVED = 1.0  # m, closer to home than this the return becomes a landing


def is_home(position: Floats, home: Floats) -> bool:
    """Whether a return that is here goes down. position, home: (3,) world, m."""
    return math.hypot(position[0] - home[0], position[1] - home[1]) < ARRIVED


@dataclass(frozen=True, slots=True)
class Demand:
    """Setpoint of the inner loop.

    attitude: body to world, w first.
    yaw_rate: feed-forward, rad/s.
    thrust: 0..1.
    climbs: whether the setpoint is above the vehicle.
    """

    attitude: list[float]
    yaw_rate: float
    thrust: float
    climbs: bool


class PositionControl:
    """Flies one position mode at a time; a mode remembers where it was entered.

    home: (3,) world, m.
    has_position: whether the estimate has a horizontal position and velocity; without, the vehicle is held level.
    """

    def __init__(self, home: Floats, tuning: Tuning) -> None:
        """home: (3,) world ENU, m: where a return ends, on the ground."""
        self.home = home.copy()
        self.tuning = tuning
        self.has_position = True
        self._kind = ""
        self._anchor = home.copy()
        self._yaw = self._yaw_rate = 0.0
        self._integral = np.zeros(3)
        self._velocity = np.zeros(3)

    def leave(self) -> None:
        """Forget the mode: another kind of setpoint is followed."""
        self._kind = ""

    def fly(self, setpoint: ControlSetpoint, now: MotionState, dt: float) -> Demand:
        """The inner loop's setpoint for the next dt seconds in a position mode."""
        if setpoint.kind != self._kind:
            self._enter(setpoint, now)
        target, velocity = self._target(setpoint, now)
        self._update_yaw(setpoint, dt)
        return self._track(target, velocity, setpoint.acceleration_world, now, dt)

    def _enter(self, setpoint: ControlSetpoint, now: MotionState) -> None:
        self._kind = setpoint.kind
        self._anchor = now.position_world + 0.5 * now.velocity_world  # stop ahead, not by a jerk
        self._anchor[2] = max(self._anchor[2], self.home[2]) if setpoint.kind == "hold" else now.position_world[2]
        self._yaw = float(quaternion.to_euler(now.attitude)[2])
        self._integral[:] = 0.0
        self._velocity = now.velocity_world.copy()

    def _target(self, setpoint: ControlSetpoint, now: MotionState) -> tuple[Floats, Floats]:
        """Position setpoint, NaN where only velocity counts, and velocity setpoint besides."""
        if setpoint.kind == "land":
            return self._descend(self._anchor[0:2], now)
        if setpoint.kind == "rtl":
            return self._return(now)
        position, velocity = setpoint.position_world, setpoint.velocity_world
        moves = np.isfinite(velocity)
        leaves = (moves | np.isfinite(setpoint.acceleration_world)) & ~np.isfinite(position)
        self._anchor = np.where(leaves, now.position_world, self._anchor)
        nowhere = np.where(leaves, np.nan, self._anchor)
        accelerates = leaves & ~moves
        return np.where(np.isfinite(position), position, nowhere), np.where(
            moves, velocity, np.where(accelerates, np.nan, 0.0)
        )

    def _descend(self, place: Floats, now: MotionState) -> tuple[Floats, Floats]:
        height = now.position_world[2] - self.home[2]
        share = min(max((height - SLOW_AT) / (SLOW_FROM - SLOW_AT), 0.0), 1.0)
        speed = self.tuning.land_speed + share * (DESCENT_SPEED - self.tuning.land_speed)
        return np.array([place[0], place[1], math.nan]), np.array([0.0, 0.0, -speed])

    def _return(self, now: MotionState) -> tuple[Floats, Floats]:
        height = self.home[2] + self.tuning.return_altitude
        if is_home(now.position_world, self.home):
            return self._descend(self.home[0:2], now)
        level = max(height, self._anchor[2])
        if now.position_world[2] < level - 1.0 and self._anchor[2] < level:
            return np.array([self._anchor[0], self._anchor[1], level]), np.zeros(3)
        self._anchor[2] = level
        return np.array([self.home[0], self.home[1], level]), np.zeros(3)

    def _update_yaw(self, setpoint: ControlSetpoint, dt: float) -> None:
        self._yaw_rate = 0.0
        if math.isfinite(setpoint.yaw):
            self._yaw = setpoint.yaw
        elif math.isfinite(setpoint.yaw_rate):
            self._yaw_rate = setpoint.yaw_rate
            self._yaw += setpoint.yaw_rate * dt

    def _track(self, target: Floats, velocity: Floats, feed_forward: Floats, now: MotionState, dt: float) -> Demand:
        """Position and velocity control with an acceleration besides; where the velocity is NaN, that alone."""
        accelerates = np.isnan(velocity)
        velocity = np.where(accelerates, now.velocity_world, velocity)
        velocity_setpoint = velocity + np.nan_to_num(POSITION_GAIN * (target - now.position_world))
        limit = max(CRUISE_SPEED, math.hypot(velocity[0], velocity[1]))
        velocity_setpoint[0:2] *= min(1.0, limit / max(math.hypot(velocity_setpoint[0], velocity_setpoint[1]), 1e-6))
        velocity_setpoint[2] = min(max(velocity_setpoint[2], -DESCENT_SPEED), CLIMB_SPEED)
        error = np.where(accelerates, 0.0, velocity_setpoint - now.velocity_world)
        slowing = (now.velocity_world - self._velocity) / dt
        self._velocity = now.velocity_world
        tracking = VELOCITY_GAIN * error + self._integral - DAMPING_GAIN * slowing
        acceleration = np.where(accelerates, 0.0, tracking) + np.nan_to_num(feed_forward)
        acceleration[0:2] *= self.has_position
        attitude, thrust, saturated = _attitude_for(acceleration.tolist(), self._yaw, self.tuning.hover_thrust)
        if not saturated:
            self._integral = np.minimum(np.maximum(self._integral + INTEGRAL_GAIN * error * dt, -5.0), 5.0)
        return Demand(
            attitude,
            self._yaw_rate,
            thrust,
            climbs=bool(velocity_setpoint[2] > TAKE_OFF_SPEED or (accelerates[2] and feed_forward[2] > 0.0)),
        )


def _attitude_for(acceleration: list[float], yaw: float, hover_thrust: float) -> tuple[list[float], float, bool]:
    """Attitude and thrust for an acceleration, m/s^2, and whether a limit of tilt or thrust was met."""
    horizontal = math.hypot(acceleration[0], acceleration[1])
    tilt = math.atan2(horizontal, GRAVITY)
    unlimited = hover_thrust * (acceleration[2] / GRAVITY + 1) / math.cos(min(tilt, TILT_MAX))
    thrust = min(max(unlimited, THRUST_MIN), THRUST_MAX)
    heading = [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
    return _tilted(heading, acceleration, min(tilt, TILT_MAX)), thrust, tilt > TILT_MAX or thrust != unlimited


def _tilted(heading: list[float], direction: list[float], tilt: float) -> list[float]:
    """The attitude of a heading (w, 0, 0, z) tilted by an angle, rad, towards a horizontal direction of the world."""
    length = max(math.hypot(direction[0], direction[1]), 1e-9)
    sine = math.sin(tilt / 2)
    a, b, c = math.cos(tilt / 2), -sine * direction[1] / length, sine * direction[0] / length
    w, z = heading[0], heading[3]
    return [a * w, b * w + c * z, c * w - b * z, a * z]
