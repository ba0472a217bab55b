"""What goes wrong between the estimator and the wire: resets, invalid numbers, a frozen or missing estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from dynamics.arrays import Floats
from dynamics.quaternion import multiply
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint, MotionState

NO_AIDING_TIME = 5.0  # s, EKF2_NOAID_TOUT


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
    gnss_lost_at: when satellite navigation was lost, simulated s; infinite while it is there.
    """

    reset_counter: int = 9
    shift: Floats = field(default_factory=lambda: np.zeros(3))
    yaw: float = 0.0
    invalid: bool = False
    frozen: bool = False
    stopped: bool = False
    gnss_lost_at: float = math.inf
    _last_reported: MotionState | None = None

    def reset(self, shift: Floats, yaw: float) -> None:
        """Move the estimate by shift (m, ENU) and its heading by yaw (rad, about up), as EKF2's resets do."""
        self.shift = self.shift + shift
        self.yaw += yaw
        self.reset_counter = (self.reset_counter + 1) % 256

    def lose_gnss(self, time: float) -> None:
        """Note the loss of satellite navigation at a simulated time, s."""
        self.gnss_lost_at = time

    def regain_gnss(self) -> None:
        """Note its return, which resets the estimate."""
        self.gnss_lost_at = math.inf
        self.reset_counter = (self.reset_counter + 1) % 256

    def has_position(self, time: float) -> bool:
        """Whether EKF2 still calls its horizontal position and velocity valid: until 5 s without aiding."""
        return time - self.gnss_lost_at < NO_AIDING_TIME

    def reported(self, state: MotionState) -> MotionState:
        """The estimate as the wire carries it."""
        if self.frozen and self._last_reported is not None:
            return replace(self._last_reported, time=state.time)
        if self.invalid:
            nothing = np.full(3, math.nan)
            return MotionState(state.time, nothing, nothing, np.full(4, math.nan), nothing)
        if not self.has_position(state.time):
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
