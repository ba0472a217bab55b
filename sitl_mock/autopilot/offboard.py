"""Offboard setpoints: the setpoint of a message by its type mask, and whether the stream of them is alive.

Measured on PX4 (`docs/px4.md`): attitude (mask 7 or 3), body rates (mask 128), both (0, where the attitude wins because
its loop overwrites the rates every step), nothing usable (7 + 128, no sign of life).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from dynamics.arrays import Floats
from dynamics.quaternion import rotate, to_euler
from sitl_mock.vehicle.vehicle_interface import ControlSetpoint
from sitl_mock.wire.dialect import Message
from sitl_mock.wire.snapshot import ORIGIN_ALTITUDE, local_from_global
from sitl_mock.wire.wire_axes import attitude_enu_flu, enu_from_ned, flu_from_frd

IGNORE_ROLL_RATE, IGNORE_PITCH_RATE, IGNORE_YAW_RATE = 1, 2, 4
THRUST_BODY_SET, IGNORE_THROTTLE, IGNORE_ATTITUDE = 32, 64, 128
LOCAL_NED, BODY_NED = 1, 8
ABOVE_SEA = (0, 5)  # MAV_FRAME_GLOBAL and _GLOBAL_INT; the others count height from home, here the origin
GLOBAL_FRAMES = (*ABOVE_SEA, 3, 6, 10, 11)
FORCE_SET = 512

Rule = Literal["measured", "documented"]


def attitude_target(message: Message) -> ControlSetpoint | None:
    """The setpoint of a SET_ATTITUDE_TARGET, None where PX4 uses nothing of it and it is no sign of life."""
    mask = message.type_mask
    thrust = _thrust(message, mask)
    rates = np.array([message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate], dtype=float)
    if mask & IGNORE_YAW_RATE:
        rates[2] = math.nan
    if not mask & IGNORE_ATTITUDE:
        return _attitude_setpoint(np.array(message.q, dtype=float), rates[2], thrust)
    if not mask & (IGNORE_ROLL_RATE | IGNORE_PITCH_RATE):
        return ControlSetpoint("rates", rate_body=flu_from_frd(rates), thrust=thrust)
    return None


def _thrust(message: Message, mask: int) -> float:
    if mask & THRUST_BODY_SET:
        body = getattr(message, "thrust_body", None)
        thrust = -float(body[2]) if body is not None else 0.0
    else:
        # an ignored throttle leaves PX4's thrust vector at zero: the vehicle falls
        thrust = 0.0 if mask & IGNORE_THROTTLE else float(message.thrust)
    return thrust if math.isfinite(thrust) else 0.0


def _attitude_setpoint(attitude_frd_ned: Floats, yaw_rate_frd: float, thrust: float) -> ControlSetpoint:
    length = math.sqrt(float(attitude_frd_ned @ attitude_frd_ned))
    if not math.isfinite(length) or length < 1e-6:
        # PX4's attitude loop then outputs NaN rates, which its rate loop treats as no control at all
        return ControlSetpoint("rates", rate_body=np.full(3, math.nan), thrust=thrust)
    feed_forward = -yaw_rate_frd if math.isfinite(yaw_rate_frd) else 0.0
    return ControlSetpoint(
        "attitude",
        attitude=attitude_enu_flu(attitude_frd_ned / length),
        rate_body=np.array([0.0, 0.0, feed_forward]),
        thrust=thrust,
    )


def position_target(message: Message, attitude: Floats) -> ControlSetpoint | None:
    """The setpoint of a SET_POSITION_TARGET_LOCAL_NED, None where PX4 refuses it.

    attitude: (4,) of the vehicle now, body to world, for velocities in BODY_NED.
    """
    if message.coordinate_frame not in (LOCAL_NED, BODY_NED):
        return None
    return _position_setpoint(message, (message.x, message.y, message.z), message.coordinate_frame, attitude)


def _position_setpoint(
    message: Message, position_ned: tuple[float, float, float], frame: int, attitude: Floats
) -> ControlSetpoint | None:
    mask = message.type_mask
    if mask & FORCE_SET:
        return None
    position = _masked(position_ned, mask, 0)
    velocity = _masked((message.vx, message.vy, message.vz), mask, 3)
    acceleration = _masked((message.afx, message.afy, message.afz), mask, 6)
    yaw = math.nan if mask & 1024 else math.pi / 2 - float(message.yaw)
    yaw_rate = math.nan if mask & 2048 else -float(message.yaw_rate)
    if frame == BODY_NED:
        position = np.full(3, math.nan)
        heading = to_euler(attitude)[2] / 2
        velocity_world = rotate(np.array([math.cos(heading), 0, 0, math.sin(heading)]), flu_from_frd(velocity))
    else:
        velocity_world = enu_from_ned(velocity)
    if not (np.isfinite(position).any() or np.isfinite(velocity).any() or np.isfinite(acceleration).any()):
        return None
    return ControlSetpoint(
        "hold",
        position_world=enu_from_ned(position),
        velocity_world=velocity_world,
        acceleration_world=enu_from_ned(acceleration),
        yaw=yaw,
        yaw_rate=yaw_rate,
    )


def global_position_target(message: Message) -> ControlSetpoint | None:
    """The setpoint of a SET_POSITION_TARGET_GLOBAL_INT, None where PX4 refuses it."""
    if message.coordinate_frame not in GLOBAL_FRAMES:
        return None
    north, east = local_from_global(message.lat_int, message.lon_int)
    above_sea = message.alt + (0.0 if message.coordinate_frame in ABOVE_SEA else ORIGIN_ALTITUDE)
    return _position_setpoint(message, (north, east, ORIGIN_ALTITUDE - above_sea), LOCAL_NED, np.zeros(4))


def _masked(values: tuple[float, float, float], mask: int, shift: int) -> Floats:
    return np.array([math.nan if mask >> (shift + axis) & 1 else values[axis] for axis in range(3)], dtype=float)


@dataclass(slots=True)
class OffboardStream:
    """The stream of offboard setpoints. All times are simulated seconds.

    rule: condition for entering OFFBOARD. measured: one setpoint (30 ms earlier was enough); documented: more than 2 Hz
        for more than 1 s.
    last: when the newest setpoint arrived.
    began: when the stream began without a gap since.
    count: setpoints so far.
    """

    rule: Rule = "measured"
    last: float = -math.inf
    began: float = math.inf
    count: int = 0
    _active: ControlSetpoint | None = None
    _arrived: deque[tuple[float, ControlSetpoint]] = field(default_factory=lambda: deque(maxlen=16))

    def feed(self, time: float, setpoint: ControlSetpoint) -> None:
        """Take a valid setpoint that arrived at a time."""
        if time - self.last >= 0.5:
            self.began = time
        self.last = time
        self.count += 1
        self._arrived.append((time, setpoint))

    def setpoint(self, time: float) -> ControlSetpoint | None:
        """The newest setpoint that had arrived by a time, which later calls must not precede."""
        while self._arrived and self._arrived[0][0] <= time:
            self._active = self._arrived.popleft()[1]
        return self._active

    def is_alive(self, time: float, timeout: float) -> bool:
        """Whether the last setpoint is younger than COM_OF_LOSS_T."""
        return time - self.last <= timeout

    def may_begin(self, time: float, timeout: float) -> bool:
        """Whether OFFBOARD may be entered, or armed in, at a time."""
        if not self.is_alive(time, timeout):
            return False
        if self.rule == "measured":
            return True
        return time - self.last < 0.5 and time - self.began > 1.0
