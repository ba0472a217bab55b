"""The vehicle's state estimate in our frames, and the judgement whether a new one can be true."""

from __future__ import annotations

import struct
from math import acos, degrees, hypot, isfinite
from typing import Literal

import msgspec
import numpy as np

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, POSITION, RATE, RIGID_BODY_STATES, VELOCITY
from runtime.link.dialect import Message, mavlink

Source = Literal["ODOMETRY", "LOCAL_POSITION_NED"]
EstimateEvent = Literal[
    "estimate_frame_refused",
    "estimate_not_finite",
    "estimate_time_backwards",
    "estimate_jump",
    "estimate_moved",
    "estimator_reset",
]

# where ODOMETRY's 13 numbers have what
_WIRE_POSITION, _WIRE_ATTITUDE, _WIRE_VELOCITY, _WIRE_RATE = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)


def _rows_from_wire() -> list[tuple[int, float, int, float]]:
    """How each of our 13 state numbers is a sum of two of ODOMETRY's: index, factor, index, factor.

    The wire has position and attitude NED, velocity NED and rate FRD. Plain numbers, because a NumPy call on a
    processor that has just woken up costs as much as this whole module may take.
    """
    matrix = np.zeros((RIGID_BODY_STATES, RIGID_BODY_STATES))
    matrix[POSITION, _WIRE_POSITION] = frames.enu_from_ned(np.eye(3)).T
    matrix[ATTITUDE, _WIRE_ATTITUDE] = frames.attitude_enu_flu(np.eye(4)).T
    matrix[VELOCITY, _WIRE_VELOCITY] = frames.enu_from_ned(np.eye(3)).T
    matrix[RATE, _WIRE_RATE] = frames.flu_from_frd(np.eye(3)).T
    rows = []
    for row in matrix:
        first, second = np.argsort(-np.abs(row), kind="stable")[:2].tolist()
        rows.append((first, float(row[first]), second, float(row[second])))
    return rows


_ROWS = _rows_from_wire()
# time_usec; x, y, z, q, vx, vy, vz, body rates; covariances left out; frame_id, child_frame_id, reset_counter
_ODOMETRY = struct.Struct("<Q13f168x3B")


class Odometry(msgspec.Struct, frozen=True, gc=False):
    """The fields of ODOMETRY that matter here. time: the vehicle's, s. wire: 13 numbers as they travel."""

    time: float
    wire: tuple[float, ...]
    frame_id: int
    child_frame_id: int
    reset_counter: int


def read_odometry(payload: bytes) -> Odometry:
    """ODOMETRY straight from its payload, without the covariances: a third of the time that decoding all takes."""
    fields = _ODOMETRY.unpack_from(payload.ljust(_ODOMETRY.size, b"\0"))
    return Odometry(fields[0] * 1e-6, fields[1:14], *fields[14:17])


class StateEstimate(msgspec.Struct, frozen=True, gc=False):
    """The vehicle's state as it estimated it.

    time: when it held; received: when its bytes arrived; both s on our monotonic clock. state: (13,) position_world m,
    velocity_world m/s, attitude, rate_body rad/s. is_synchronised: whether time comes from the
    vehicle's clock rather than from the arrival.
    """

    time: float
    received: float
    state: Floats
    reset_counter: int
    is_synchronised: bool
    source: Source

    @property
    def position_world(self) -> Floats:
        """Position, m, (3,)."""
        return self.state[POSITION]

    @property
    def velocity_world(self) -> Floats:
        """Velocity, m/s, (3,)."""
        return self.state[VELOCITY]

    @property
    def attitude(self) -> Floats:
        """Attitude, body to world, (4,), continuous in sign from one estimate to the next."""
        return self.state[ATTITUDE]

    @property
    def rate_body(self) -> Floats:
        """Body rates, rad/s, (3,)."""
        return self.state[RATE]


class ResetStep(msgspec.Struct, frozen=True):
    """What an estimator reset moved: position, m, and velocity, m/s, world (3,), and yaw, rad."""

    position_world: Floats
    velocity_world: Floats
    yaw: float


class Judgement(msgspec.Struct, frozen=True):
    """What became of one message: the estimate if it is believed, and the finding if there is something to tell."""

    estimate: StateEstimate | None
    event: EstimateEvent | None = None
    text: str = ""
    step: ResetStep | None = None


class EstimateLimits(msgspec.Struct, frozen=True):
    """What physics and an estimator's noise allow between two samples."""

    position_noise: float = 0.3  # m
    velocity_noise: float = 1.5  # m/s
    attitude_noise: float = 0.3  # rad
    max_acceleration: float = 80.0  # m/s^2
    max_rate: float = 35.0  # rad/s
    attitude_length: float = 0.05  # deviation of the quaternion's length from 1
    moved_samples: int = 10  # consecutive jumps that agree with each other are where the vehicle is now
    forgotten_after: float = 1.0  # s of silence after which nothing is compared any more
    odometry_silence: float = 0.5  # s without ODOMETRY until LOCAL_POSITION_NED and ATTITUDE_QUATERNION stand in


class EstimateMonitor:
    """Makes estimates of messages and believes those that can be true. Pure: times are arguments."""

    def __init__(self, limits: EstimateLimits | None = None) -> None:
        self._limits = limits or EstimateLimits()
        self.reset()

    def reset(self) -> None:
        """Forgets the past, as after a reboot of the vehicle."""
        self.latest: StateEstimate | None = None
        self._doubted: list[StateEstimate] = []
        self._odometry_received = float("-inf")
        self._local_position: tuple[float, Message] | None = None

    def age(self, now: float) -> float:
        """Seconds since the latest believed estimate held; infinite before the first."""
        return now - self.latest.time if self.latest is not None else float("inf")

    def handle_odometry(self, odometry: Odometry, time: float, received: float, is_synchronised: bool) -> Judgement:
        """An ODOMETRY message whose state held at time, s on our clock."""
        self._odometry_received = received
        if odometry.frame_id != mavlink.MAV_FRAME_LOCAL_NED:
            return _refused_frame("frame_id", odometry.frame_id, "1 (LOCAL_NED)")
        state = _state_from_wire(odometry.wire)
        if odometry.child_frame_id == mavlink.MAV_FRAME_BODY_FRD:
            velocity_body = frames.flu_from_frd(odometry.wire[_WIRE_VELOCITY])
            state[VELOCITY] = quaternion.rotate(np.array(state[ATTITUDE]), velocity_body).tolist()
        elif odometry.child_frame_id != mavlink.MAV_FRAME_LOCAL_NED:
            return _refused_frame("child_frame_id", odometry.child_frame_id, "1 (LOCAL_NED) or 12 (BODY_FRD)")
        return self._judge(state, time, received, odometry.reset_counter, is_synchronised, "ODOMETRY")

    def handle_local_position(self, message: Message, time: float) -> None:
        """A LOCAL_POSITION_NED message, kept for the attitude that follows it."""
        self._local_position = (time, message)

    def handle_attitude(
        self, message: Message, time: float, received: float, is_synchronised: bool
    ) -> Judgement | None:
        """An ATTITUDE_QUATERNION message; makes an estimate with the latest position while no ODOMETRY comes."""
        if received - self._odometry_received < self._limits.odometry_silence or self._local_position is None:
            return None
        position_time, position = self._local_position
        step = time - position_time
        if abs(step) > self._limits.odometry_silence:
            return None
        velocity = (position.vx, position.vy, position.vz)
        place = (position.x + step * position.vx, position.y + step * position.vy, position.z + step * position.vz)
        attitude = (message.q1, message.q2, message.q3, message.q4)
        wire = (*place, *attitude, *velocity, message.rollspeed, message.pitchspeed, message.yawspeed)
        return self._judge(_state_from_wire(wire), time, received, 0, is_synchronised, "LOCAL_POSITION_NED")

    def _judge(
        self,
        values: list[float],
        time: float,
        received: float,
        reset_counter: int,
        is_synchronised: bool,
        source: Source,
    ) -> Judgement:
        latest, length = self.latest, hypot(*values[ATTITUDE])
        if not isfinite(sum(values)) or not abs(length - 1.0) < self._limits.attitude_length:
            return Judgement(None, "estimate_not_finite", "The estimate holds NaN or infinity, or no unit quaternion.")
        factor = 1.0 / length
        if latest is not None and _dot(values[ATTITUDE], latest.attitude.tolist()) < 0:
            factor = -factor
        values[ATTITUDE] = [factor * value for value in values[ATTITUDE]]
        state = np.array(values)
        estimate = StateEstimate(time, received, state, reset_counter, is_synchronised, source)
        if latest is None or received - latest.received > self._limits.forgotten_after or source != latest.source:
            return self._believe(estimate)
        if time <= latest.time:
            return self._judge_time(estimate, latest)
        if reset_counter != latest.reset_counter:
            return self._judge_reset(estimate, latest)
        if (jump := self._jump(latest, estimate)) is None:
            return self._believe(estimate)
        return self._doubt(estimate, latest, jump)

    def _believe(self, estimate: StateEstimate) -> Judgement:
        self.latest = estimate
        self._doubted.clear()
        return Judgement(estimate)

    def _judge_time(self, estimate: StateEstimate, latest: StateEstimate) -> Judgement:
        if latest.is_synchronised != estimate.is_synchronised:
            return self._believe(estimate)  # the clock has just been found, or lost
        if latest.time - estimate.time < 1e-3:
            return Judgement(None)  # the same sample sent twice
        text = f"The estimate's time went back by {latest.time - estimate.time:.3f} s."
        return Judgement(None, "estimate_time_backwards", text)

    def _judge_reset(self, estimate: StateEstimate, latest: StateEstimate) -> Judgement:
        step = _step(latest, estimate)
        text = (
            f"The estimator was reset: position moved by {np.linalg.norm(step.position_world):.2f} m, "
            f"velocity by {np.linalg.norm(step.velocity_world):.2f} m/s, yaw by {np.degrees(step.yaw):.1f} degrees."
        )
        self._believe(estimate)
        return Judgement(estimate, "estimator_reset", text, step)

    def _doubt(self, estimate: StateEstimate, latest: StateEstimate, jump: str) -> Judgement:
        if self._doubted and self._jump(self._doubted[-1], estimate) is not None:
            self._doubted.clear()
        self._doubted.append(estimate)
        if len(self._doubted) < self._limits.moved_samples:
            return Judgement(None, "estimate_jump", f"The estimate jumped: {jump}.")
        self._believe(estimate)
        text = f"The estimate has moved for good, without a reset being told: {jump}."
        return Judgement(estimate, "estimate_moved", text, _step(latest, estimate))

    def _jump(self, before: StateEstimate, after: StateEstimate) -> str | None:
        """What moved further from one estimate to the next than physics allows, or None."""
        limits, elapsed = self._limits, abs(after.time - before.time)
        a, b = before.state.tolist(), after.state.tolist()
        half = 0.5 * elapsed
        position = hypot(
            b[0] - a[0] - half * (a[3] + b[3]), b[1] - a[1] - half * (a[4] + b[4]), b[2] - a[2] - half * (a[5] + b[5])
        )
        velocity = hypot(b[3] - a[3], b[4] - a[4], b[5] - a[5])
        attitude = 2.0 * acos(min(1.0, abs(_dot(a[ATTITUDE], b[ATTITUDE]))))
        if position > limits.position_noise + 0.25 * limits.max_acceleration * elapsed**2:
            return f"position by {position:.2f} m in {elapsed * 1e3:.0f} ms"
        if velocity > limits.velocity_noise + limits.max_acceleration * elapsed:
            return f"velocity by {velocity:.2f} m/s in {elapsed * 1e3:.0f} ms"
        if attitude > limits.attitude_noise + limits.max_rate * elapsed:
            return f"attitude by {degrees(attitude):.0f} degrees in {elapsed * 1e3:.0f} ms"
        return None


def _state_from_wire(wire: tuple[float, ...]) -> list[float]:
    return [factor * wire[first] + other * wire[second] for first, factor, second, other in _ROWS]


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


def _step(before: StateEstimate, after: StateEstimate) -> ResetStep:
    """What a reset moved, the vehicle's own motion in between taken out."""
    elapsed = max(0.0, after.time - before.time)
    travelled = elapsed * before.velocity_world
    turned = quaternion.multiply(before.attitude, quaternion.exponential(elapsed * before.rate_body))
    yaw = float(quaternion.to_euler(after.attitude)[2] - quaternion.to_euler(turned)[2])
    return ResetStep(
        after.position_world - before.position_world - travelled,
        after.velocity_world - before.velocity_world,
        (yaw + np.pi) % (2 * np.pi) - np.pi,
    )


def _refused_frame(field: str, value: int, required: str) -> Judgement:
    entry = mavlink.enums["MAV_FRAME"].get(value)
    name = entry.name.removeprefix("MAV_FRAME_") if entry is not None else "unknown"
    text = f"ODOMETRY {field} is {value} ({name}), required {required}: the estimate's axes are not known."
    return Judgement(None, "estimate_frame_refused", text)
