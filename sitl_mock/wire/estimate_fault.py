"""Faults between the estimator and the wire: resets, invalid numbers, a frozen or missing estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from dynamics.arrays import Floats
from dynamics.quaternion import multiply
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, MotionState


def _heading(yaw: float) -> Floats:
    return np.array([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])


@dataclass(slots=True)
class EstimateFault:
    """The estimator's frame on the wire, moved by resets, and its failures.

    reset_counter: ODOMETRY's; PX4 has counted some before take-off.
    shift: (3,) sum of all resets of the position, ENU, m.
    yaw: sum of all resets of the heading, about up, rad.
    invalid: NaN instead of numbers.
    frozen: the estimate stays constant while its time stamps advance.
    stopped: no estimate is sent at all.
    lead: s by which the estimate is stamped ahead of the vehicle's clock.
    gnss_glitch: ESTIMATOR_STATUS reports jumps of the GPS.
    has_position: whether EKF2 calls its horizontal position and velocity valid.
    """

    reset_counter: int = 9
    shift: Floats = field(default_factory=lambda: np.zeros(3))
    yaw: float = 0.0
    invalid: bool = False
    frozen: bool = False
    stopped: bool = False
    lead: float = 0.0
    gnss_glitch: bool = False
    has_position: bool = True
    _last_reported: MotionState | None = None

    def reset(self, shift: Floats, yaw: float) -> None:
        """Move the estimate by shift (m, ENU) and its heading by yaw (rad, about up), as EKF2's resets do."""
        self.shift = self.shift + shift
        self.yaw += yaw
        self.reset_counter = (self.reset_counter + 1) % 256

    def move(self, shift: Floats, yaw: float) -> None:
        """Move the estimate without a word: the counter stays."""
        self.shift = self.shift + shift
        self.yaw += yaw

    def watch_position(self, has_position: bool) -> None:
        """Note whether the estimator has a position; its return is a reset."""
        if has_position and not self.has_position:
            self.reset_counter = (self.reset_counter + 1) % 256
        self.has_position = has_position

    def reported(self, state: MotionState) -> MotionState:
        """The estimate as the wire carries it."""
        if self.frozen and self._last_reported is not None:
            return replace(self._last_reported, time=state.time)
        if self.invalid:
            nothing = np.full(3, math.nan)
            return MotionState(state.time, nothing, nothing, np.full(4, math.nan), nothing)
        if not self.has_position:
            nothing = np.array([math.nan, math.nan, 0.0])
            position, velocity = state.position_world + nothing, state.velocity_world + nothing
            state = replace(state, position_world=position, velocity_world=velocity)
        if self.yaw or self.shift.any():
            state = replace(
                state,
                position_world=state.position_world + self.shift,
                attitude=multiply(_heading(self.yaw), state.attitude),
            )
        self._last_reported = state
        return state

    def to_plant_frame(self, setpoint: ControlSetpoint) -> ControlSetpoint:
        """A setpoint of the estimator's moved frame in the frame of the plant."""
        if not self.yaw and not self.shift.any():
            return setpoint
        return replace(
            setpoint,
            attitude=multiply(_heading(-self.yaw), setpoint.attitude),
            position_world=setpoint.position_world - self.shift,
            yaw=setpoint.yaw - self.yaw,
        )
