"""The vehicle's state estimate in our frames, and the checks whether a new one is plausible."""

from __future__ import annotations

from math import acos, degrees, isfinite, sqrt
from typing import Literal

import msgspec
import numpy as np

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.state import ATTITUDE, POSITION, RATE, VELOCITY
from runtime.link.dialect import Message, mavlink
from runtime.link.odometry import WIRE_VELOCITY, Odometry, state_from_wire

Source = Literal["ODOMETRY", "LOCAL_POSITION_NED"]
EstimateEvent = Literal[
    "estimate_frame_refused",
    "estimate_not_finite",
    "estimate_out_of_range",
    "estimate_time_backwards",
    "estimate_jump",
    "estimate_moved",
    "estimator_reset",
]


class StateEstimate(msgspec.Struct, frozen=True, gc=False):
    """The vehicle's state as the vehicle estimates it.

    time: when the state held, s on our monotonic clock.
    received: when its bytes arrived, s on our monotonic clock.
    state: (13,), see `dynamics.state`.
    reset_counter: of the vehicle's estimator.
    is_synchronised: whether `time` is from the vehicle's clock rather than from the arrival.
    source: the message.
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
    """By how much an estimator reset moved position, (3,) m, and velocity, (3,) m/s, both world, and yaw, rad."""

    position_world: Floats
    velocity_world: Floats
    yaw: float


class EstimateCheck(msgspec.Struct, frozen=True):
    """The outcome of the checks of one message.

    estimate: None if it is rejected.
    event: name of what happened, None if nothing did.
    text: the event's.
    step: what a reset moved.
    """

    estimate: StateEstimate | None
    event: EstimateEvent | None = None
    text: str = ""
    step: ResetStep | None = None


class EstimateLimits(msgspec.Struct, frozen=True):
    """The largest change that motion and an estimator's noise explain between two samples.

    position_noise: m.
    velocity_noise: m/s.
    attitude_noise: rad.
    max_acceleration: m/s^2.
    max_rate: rad/s.
    attitude_length: deviation of the quaternion's length from 1.
    max_distance: m from the frame's origin, where the single precision of the wire resolves 8 mm and a plane tangent to
        the earth lies 800 m above it; beyond it a reset does not make a position credible.
    max_speed: m/s, likewise.
    moved_samples: consecutive jumps that agree with each other, after which they are accepted.
    overtaken: s by which a sample may be older than the one before, on a path that reorders; it is dropped.
    forgotten_after: s of silence after which nothing is compared.
    odometry_silence: s without ODOMETRY after which LOCAL_POSITION_NED and ATTITUDE_QUATERNION replace it.
    """

    position_noise: float = 0.3
    velocity_noise: float = 1.5
    attitude_noise: float = 0.3
    max_acceleration: float = 80.0
    max_rate: float = 35.0
    attitude_length: float = 0.05
    max_distance: float = 1e5
    max_speed: float = 1e3
    moved_samples: int = 10
    overtaken: float = 0.1
    forgotten_after: float = 1.0
    odometry_silence: float = 0.5


class EstimateMonitor:
    """Makes estimates from messages and accepts the plausible ones. Pure: times are arguments.

    limits: of the checks.
    latest: the newest accepted one.
    """

    def __init__(self, limits: EstimateLimits | None = None) -> None:
        self.limits = limits or EstimateLimits()
        self.reset()

    def reset(self) -> None:
        """Forget all estimates, as after a reboot of the vehicle."""
        self.latest: StateEstimate | None = None
        self._stamp = float("-inf")
        self._jumps: list[StateEstimate] = []
        self._odometry_received = float("-inf")
        self._local_position: tuple[float, Message] | None = None

    def handle_odometry(self, odometry: Odometry, time: float, received: float, is_synchronised: bool) -> EstimateCheck:
        """Check an ODOMETRY message. time: when its state held, s on our clock."""
        self._odometry_received = received
        if odometry.frame_id != mavlink.MAV_FRAME_LOCAL_NED:
            return _refused_frame("frame_id", odometry.frame_id, "1 (LOCAL_NED)")
        state = state_from_wire(odometry.wire)
        if odometry.child_frame_id == mavlink.MAV_FRAME_BODY_FRD:
            velocity_body = frames.flu_from_frd(odometry.wire[WIRE_VELOCITY])
            state[VELOCITY] = quaternion.rotate(np.array(state[ATTITUDE]), velocity_body).tolist()
        elif odometry.child_frame_id != mavlink.MAV_FRAME_LOCAL_NED:
            return _refused_frame("child_frame_id", odometry.child_frame_id, "1 (LOCAL_NED) or 12 (BODY_FRD)")
        return self._check(state, odometry.time, time, received, odometry.reset_counter, is_synchronised, "ODOMETRY")

    def adopt(self, estimate: StateEstimate, stamp: float) -> EstimateCheck:
        """Take an estimate that `alula_tick` has checked and a setpoint has answered. stamp: of the vehicle, s."""
        self._odometry_received, self._stamp = estimate.received, stamp
        return self._accept(estimate)

    @property
    def stamp(self) -> float:
        """The vehicle's stamp of the newest estimate, s; -inf before the first."""
        return self._stamp

    def handle_local_position(self, message: Message, time: float) -> None:
        """Store a LOCAL_POSITION_NED message for the attitude that follows it."""
        self._local_position = (time, message)

    def handle_attitude(
        self, message: Message, time: float, received: float, is_synchronised: bool
    ) -> EstimateCheck | None:
        """Check an ATTITUDE_QUATERNION message together with the latest position; None while ODOMETRY comes."""
        if received - self._odometry_received < self.limits.odometry_silence or self._local_position is None:
            return None
        position_time, position = self._local_position
        step = time - position_time
        if abs(step) > self.limits.odometry_silence:
            return None
        velocity = (position.vx, position.vy, position.vz)
        place = (position.x + step * position.vx, position.y + step * position.vy, position.z + step * position.vz)
        attitude = (message.q1, message.q2, message.q3, message.q4)
        wire = (*place, *attitude, *velocity, message.rollspeed, message.pitchspeed, message.yawspeed)
        stamp, state = message.time_boot_ms * 1e-3, state_from_wire(wire)
        return self._check(state, stamp, time, received, 0, is_synchronised, "LOCAL_POSITION_NED")

    def _check(
        self,
        values: list[float],
        stamp: float,
        time: float,
        received: float,
        reset_counter: int,
        is_synchronised: bool,
        source: Source,
    ) -> EstimateCheck:
        latest, length = self.latest, sqrt(_dot(values[ATTITUDE], values[ATTITUDE]))
        if not isfinite(sum(values)) or not abs(length - 1.0) < self.limits.attitude_length:
            return EstimateCheck(
                None, "estimate_not_finite", "The estimate holds NaN or infinity, or no unit quaternion."
            )
        if text := self._out_of_range(values):
            return EstimateCheck(None, "estimate_out_of_range", text)
        factor = 1.0 / length
        if latest is not None and _dot(values[ATTITUDE], latest.attitude.tolist()) < 0:
            factor = -factor
        values[ATTITUDE] = [factor * value for value in values[ATTITUDE]]
        state = np.array(values)
        new = latest is None or received - latest.received > self.limits.forgotten_after or source != latest.source
        stamp = stamp if is_synchronised else time  # of no clock that is followed, it may be anything, 0 as well
        if latest is not None and not new and is_synchronised == latest.is_synchronised:
            age = self._stamp - stamp
            if age >= 0:
                return self._check_age(age)
            if time <= latest.time:  # the clock's filter has moved: the vehicle's own stamps order its samples
                time = min(latest.time - age, max(received, latest.time))
        self._stamp = stamp
        estimate = StateEstimate(time, received, state, reset_counter, is_synchronised, source)
        if latest is None or new:
            return self._accept(estimate)
        if reset_counter != latest.reset_counter:
            return self._check_reset(estimate, latest)
        if (jump := self._jump(latest, estimate)) is None:
            return self._accept(estimate)
        return self._check_jump(estimate, latest, jump)

    def _out_of_range(self, values: list[float]) -> str:
        """The quantity that no vehicle of a local frame can have, empty where there is none."""
        distance, speed = _length(*values[POSITION]), _length(*values[VELOCITY])
        if distance > self.limits.max_distance:
            return f"The estimated position is {distance:.3g} m from the origin, at most {self.limits.max_distance:g}."
        if speed > self.limits.max_speed:
            return f"The estimated speed is {speed:.3g} m/s, at most {self.limits.max_speed:g}."
        return ""

    def _accept(self, estimate: StateEstimate) -> EstimateCheck:
        self.latest = estimate
        self._jumps.clear()
        return EstimateCheck(estimate)

    def _check_age(self, age: float) -> EstimateCheck:
        """The outcome of a sample that is older than the one before. age: by how much, s; 0 of one sent twice."""
        if age < self.limits.overtaken:
            return EstimateCheck(None)
        return EstimateCheck(None, "estimate_time_backwards", f"The estimate's time went back by {age:.3f} s.")

    def _check_reset(self, estimate: StateEstimate, latest: StateEstimate) -> EstimateCheck:
        step = _step(latest, estimate)
        text = (
            f"The estimator was reset: position moved by {np.linalg.norm(step.position_world):.2f} m, "
            f"velocity by {np.linalg.norm(step.velocity_world):.2f} m/s, yaw by {np.degrees(step.yaw):.1f} degrees."
        )
        self._accept(estimate)
        return EstimateCheck(estimate, "estimator_reset", text, step)

    def _check_jump(self, estimate: StateEstimate, latest: StateEstimate, jump: str) -> EstimateCheck:
        if self._jumps and self._jump(self._jumps[-1], estimate) is not None:
            self._jumps.clear()
        self._jumps.append(estimate)
        if len(self._jumps) < self.limits.moved_samples:
            return EstimateCheck(None, "estimate_jump", f"The estimate jumped: {jump}.")
        self._accept(estimate)
        text = f"The estimate has moved for good without a reset: {jump}."
        return EstimateCheck(estimate, "estimate_moved", text, _step(latest, estimate))

    def _jump(self, before: StateEstimate, after: StateEstimate) -> str | None:
        """Quantity that moved further from one estimate to the next than the limits allow, or None."""
        limits, elapsed = self.limits, abs(after.time - before.time)
        half = 0.5 * elapsed
        # plain numbers: this runs for every estimate, and NumPy would take longer
        start, end = before.state.tolist(), after.state.tolist()
        (x0, y0, z0), (x1, y1, z1) = start[POSITION], end[POSITION]
        (u0, v0, w0), (u1, v1, w1) = start[VELOCITY], end[VELOCITY]
        position = _length(x1 - x0 - half * (u0 + u1), y1 - y0 - half * (v0 + v1), z1 - z0 - half * (w0 + w1))
        velocity = _length(u1 - u0, v1 - v0, w1 - w0)
        attitude = 2.0 * acos(min(1.0, abs(_dot(start[ATTITUDE], end[ATTITUDE]))))
        if position > limits.position_noise + 0.25 * limits.max_acceleration * (elapsed * elapsed):
            return f"position by {position:.2f} m in {elapsed * 1e3:.0f} ms"
        if velocity > limits.velocity_noise + limits.max_acceleration * elapsed:
            return f"velocity by {velocity:.2f} m/s in {elapsed * 1e3:.0f} ms"
        if attitude > limits.attitude_noise + limits.max_rate * elapsed:
            return f"attitude by {degrees(attitude):.0f} degrees in {elapsed * 1e3:.0f} ms"
        return None


def _length(x: float, y: float, z: float) -> float:
    """The length of a vector, as `alula_tick` computes it."""
    return sqrt(x * x + y * y + z * z)


def _dot(a: list[float], b: list[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


def _step(before: StateEstimate, after: StateEstimate) -> ResetStep:
    """Step of a reset, without the vehicle's own motion in between."""
    elapsed = max(0.0, after.time - before.time)
    travelled = elapsed * before.velocity_world
    rotated = quaternion.multiply(before.attitude, quaternion.exponential(elapsed * before.rate_body))
    yaw = float(quaternion.to_euler(after.attitude)[2] - quaternion.to_euler(rotated)[2])
    return ResetStep(
        after.position_world - before.position_world - travelled,
        after.velocity_world - before.velocity_world,
        (yaw + np.pi) % (2 * np.pi) - np.pi,
    )


def _refused_frame(field: str, value: int, required: str) -> EstimateCheck:
    entry = mavlink.enums["MAV_FRAME"].get(value)
    name = entry.name.removeprefix("MAV_FRAME_") if entry is not None else "unknown"
    text = f"ODOMETRY {field} is {value} ({name}), required {required}: the estimate's axes are undefined."
    return EstimateCheck(None, "estimate_frame_refused", text)
