"""ROS messages of a flight as streams: which fields, in which order, in which frames."""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from dynamics import frames
from dynamics.arrays import Floats
from dynamics.units import RPM
from flights.assembly import MAX_VALUE, Assembly
from flights.readers.bag_clocks import Clock
from flights.readers.px4_rotors import add_servo_outputs
from flights.velocity_frame import velocity_world

Message = Any  # an instance of a class that rosbags makes of a message's definition

_ROTOR_FIELD = re.compile(r"rpm_?(\d+)$")
_ON_GROUND = 1  # mavros_msgs/ExtendedState
_MAVROS_IGNORE_ATTITUDE, _MAVROS_IGNORE_RATES = 128, 7


class Samples:
    """The numbers of one topic's messages. Grows flat, so that a long bag stays small in memory."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.stamps = array("q")
        self.recorded = array("q")
        self.unstamped = 0
        self.width = 0
        self.frames: set[tuple[str, str]] = set()
        self._numbers = array("d")
        self._fields: list[str] = []

    def __len__(self) -> int:
        return len(self.stamps)

    def add(self, recorded: int, message: Message) -> None:
        """Add a message. recorded: its time in the bag, ns; used where the header has no stamp."""
        numbers = [float(number) for number in self._extract(message)]
        if self.stamps and len(numbers) != self.width:
            raise ValueError(f"{len(numbers)} instead of {self.width} numbers")
        self.width = len(numbers)
        header = getattr(message, "header", None)
        stamp = 0 if header is None else header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
        self.unstamped += stamp == 0
        self.stamps.append(stamp or recorded)
        self.recorded.append(recorded)
        self._numbers.extend(numbers)
        if header is not None:
            self.frames.add((header.frame_id, getattr(message, "child_frame_id", "")))

    def _extract(self, message: Message) -> Iterable[float]:
        converter = CONVERTERS.get(self.kind)
        if converter is not None:
            return converter[0](message)
        if not self._fields:
            self._fields = rotor_fields([name for name in dir(message) if not name.startswith("_")])
        return (getattr(message, field) for field in self._fields)

    def convert(self, assembly: Assembly, topic: str, clock: Clock, *, is_paper: bool) -> None:
        """Add the topic's streams. clock: of its stamps. is_paper: in a bag of the paper's set."""
        time = assembly.seconds((np.array(self.stamps) + clock.shift)[clock.rows], 1_000_000_000)
        if self.unstamped and self.kind in CONVERTERS:
            assembly.note(f"{topic}: {self.unstamped} messages without a stamp have the time of their recording")
        values = np.array(self._numbers).reshape(len(self), -1)[clock.rows]
        values[~(np.abs(values) < MAX_VALUE)] = np.nan  # before anything is computed with damage
        converter = CONVERTERS.get(self.kind)
        if converter is None:
            assembly.add("rotor_speed", time, np.abs(values) * RPM, topic)
            return
        converter[1](assembly, TopicRows(topic, time, values, frozenset(self.frames), is_paper))


class TopicRows:
    """All messages of one topic.

    time: (n,) s.
    values: (n, k) in the order of the extraction.
    frames: frame_id and child_frame_id of the headers.
    is_paper: whether they are of a bag of the paper's set.
    """

    def __init__(
        self, topic: str, time: Floats, values: Floats, named_frames: frozenset[tuple[str, str]], is_paper: bool
    ) -> None:
        self.topic = topic
        self.time = time
        self.values = values
        self.frames = named_frames
        self.is_paper = is_paper


def rotor_fields(names: Sequence[str]) -> list[str]:
    """The fields rpm_0, rpm_1, ... of a custom message by number, empty when it has no such."""
    numbered = {int(match.group(1)): name for name in names if (match := _ROTOR_FIELD.match(name))}
    complete = len(numbered) >= 3 and sorted(numbered) == list(range(min(numbered), min(numbered) + len(numbered)))
    return [numbered[number] for number in sorted(numbered)] if complete else []


def _vector(v: Message) -> tuple[float, float, float]:
    return v.x, v.y, v.z


def _quaternion(q: Message) -> tuple[float, float, float, float]:
    return q.w, q.x, q.y, q.z


def _of_odometry(m: Message) -> Iterable[float]:
    pose, twist = m.pose.pose, m.twist.twist
    return (*_vector(pose.position), *_quaternion(pose.orientation), *_vector(twist.linear), *_vector(twist.angular))


def _odometry(assembly: Assembly, rows: TopicRows) -> None:
    position, attitude, velocity, rate = np.split(rows.values, [3, 7, 10], axis=1)
    assembly.add("position", rows.time, position, rows.topic)
    assembly.add("attitude", rows.time, attitude, rows.topic)
    if rows.is_paper:
        assembly.add("velocity", rows.time, velocity, rows.topic)
    else:
        in_world = velocity_world(rows.time, position, attitude, velocity)
        assembly.note(f"{rows.topic}: the velocity is in {in_world.frame} ({in_world.reason})")
        assembly.add("velocity", rows.time, in_world.velocity, rows.topic)
    if np.ptp(rate, axis=0).max() > 0:  # mocap often leaves it zero
        assembly.add("rate", rows.time, rate, rows.topic, spare=True)  # a gyroscope's are better


def _of_imu(m: Message) -> Iterable[float]:
    has_orientation = m.orientation_covariance[0] != -1
    orientation = _quaternion(m.orientation) if has_orientation else (np.nan,) * 4
    return (*_vector(m.angular_velocity), *_vector(m.linear_acceleration), *orientation)


def _imu(assembly: Assembly, rows: TopicRows) -> None:
    rate, force, attitude = np.split(rows.values, [3, 6], axis=1)
    if rows.is_paper:
        rate = frames.flu_from_frd(rate)
        if np.nanmedian(force[:, 2]) < 0:
            force = frames.flu_from_frd(force)
            assembly.repair("force_frd_to_flu", f"{rows.topic}: the specific force points down in hover, so it is FRD")
    elif np.nanmedian(force[:, 2]) < -4.9:
        rate, force = frames.flu_from_frd(rate), frames.flu_from_frd(force)
        assembly.repair(
            "imu_frd_to_flu",
            f"{rows.topic}: the specific force points down ({np.nanmedian(rows.values[:, 5]):.1f} m/s^2), so that the "
            "IMU is FRD and not FLU as REP 103 has it; rates and force turned",
        )
    assembly.add("rate", rows.time, rate, rows.topic)
    assembly.add("specific_force", rows.time, force, rows.topic)
    length = np.linalg.norm(attitude, axis=1)
    if np.nanmedian(np.where(np.isfinite(length), length, 0.0)) > 0.5:  # all zero: never filled in
        assembly.add("attitude", rows.time, attitude, rows.topic, spare=True)  # mocap's or an estimator's is better


def _of_pose_stamped(m: Message) -> Iterable[float]:
    return (*_vector(m.pose.position), *_quaternion(m.pose.orientation))


def _of_pose_with_covariance(m: Message) -> Iterable[float]:
    return (*_vector(m.pose.pose.position), *_quaternion(m.pose.pose.orientation))


def _of_transform(m: Message) -> Iterable[float]:
    return (*_vector(m.transform.translation), *_quaternion(m.transform.rotation))


def _pose(assembly: Assembly, rows: TopicRows) -> None:
    is_setpoint = "setpoint" in rows.topic or "command" in rows.topic
    names = ("position_setpoint", "attitude_setpoint") if is_setpoint else ("position", "attitude")
    assembly.add(names[0], rows.time, rows.values[:, :3], rows.topic)
    assembly.add(names[1], rows.time, rows.values[:, 3:], rows.topic)


def _of_twist(m: Message) -> Iterable[float]:
    return (*_vector(m.twist.linear), *_vector(m.twist.angular))


def _twist(assembly: Assembly, rows: TopicRows) -> None:
    """mavros publishes `velocity_local` in the world and `velocity_body` in the body; others define no frame."""
    is_setpoint = "setpoint" in rows.topic or "command" in rows.topic
    if not is_setpoint:
        reason = "the frame of a twist's rates is not stated"
        assembly.leave_out("rate", rows.topic, ("angular.x", "angular.y", "angular.z"), rows.values[:, 3:], reason)
    if is_setpoint:
        assembly.add("velocity_setpoint", rows.time, rows.values[:, :3], rows.topic)
    elif "body" in rows.topic:
        reason = "its name says that it is a body velocity, and no attitude of its own turns it into the world"
        assembly.note(f"{rows.topic}: a body velocity by its name, left out")
        assembly.leave_out("velocity", rows.topic, ("linear.x", "linear.y", "linear.z"), rows.values[:, :3], reason)
    else:
        assembly.note(f"{rows.topic}: its velocity is taken for the world's, as mavros's velocity_local is")
        assembly.add("velocity", rows.time, rows.values[:, :3], rows.topic)


def _of_battery(m: Message) -> Iterable[float]:
    return m.voltage, abs(m.current)


def _battery(assembly: Assembly, rows: TopicRows) -> None:
    assembly.add("battery_voltage", rows.time, rows.values[:, 0], rows.topic)
    assembly.add("battery_current", rows.time, rows.values[:, 1], rows.topic)


def _of_state(m: Message) -> Iterable[float]:
    return (m.armed,)


def _state(assembly: Assembly, rows: TopicRows) -> None:
    assembly.add("armed", rows.time, rows.values, rows.topic)


def _of_extended_state(m: Message) -> Iterable[float]:
    return (np.nan if m.landed_state == 0 else m.landed_state == _ON_GROUND,)


def _extended_state(assembly: Assembly, rows: TopicRows) -> None:
    assembly.add("landed", rows.time, rows.values, rows.topic)


def _of_attitude_target(m: Message) -> Iterable[float]:
    attitude = (np.nan,) * 4 if m.type_mask & _MAVROS_IGNORE_ATTITUDE else _quaternion(m.orientation)
    rate = (np.nan,) * 3 if m.type_mask & _MAVROS_IGNORE_RATES else _vector(m.body_rate)
    return (*attitude, *rate, m.thrust)


def _attitude_target(assembly: Assembly, rows: TopicRows) -> None:
    assembly.add("attitude_setpoint", rows.time, rows.values[:, :4], rows.topic)
    assembly.add("rate_setpoint", rows.time, rows.values[:, 4:7], rows.topic)
    assembly.add("thrust_setpoint", rows.time, rows.values[:, 7], rows.topic)


def _of_actuators(m: Message) -> Iterable[float]:
    return [abs(speed) for speed in m.angular_velocities]


def _actuators(assembly: Assembly, rows: TopicRows) -> None:
    """Speeds in rad/s as of RotorS; commands where the topic's name has the word."""
    name = "rotor_speed_command" if "command" in rows.topic else "rotor_speed"
    assembly.add(name, rows.time, rows.values, rows.topic)
    assembly.note(f"{rows.topic}: rotors in the order of the message")


def _of_esc(m: Message) -> Iterable[float]:
    return [abs(esc.rpm) * RPM for esc in (m.esc_telemetry if hasattr(m, "esc_telemetry") else m.esc_status)]


def _esc(assembly: Assembly, rows: TopicRows) -> None:
    assembly.add("rotor_speed", rows.time, rows.values, rows.topic)
    assembly.note(f"{rows.topic}: rotors in the order of the message, which is the autopilot's")


def _of_pulses(m: Message) -> Iterable[float]:
    return [*m.channels]


def _pulses(assembly: Assembly, rows: TopicRows) -> None:
    add_servo_outputs(assembly, rows.time, rows.values, rows.topic, of_px4=False)


_Extract = Callable[[Message], Iterable[float]]
_Convert = Callable[[Assembly, TopicRows], None]
# Message type, ROS 1's spelt as rosbags does: extraction of a message's numbers, and their conversion to streams.
CONVERTERS: Mapping[str, tuple[_Extract, _Convert]] = {
    "nav_msgs/msg/Odometry": (_of_odometry, _odometry),
    "sensor_msgs/msg/Imu": (_of_imu, _imu),
    "geometry_msgs/msg/PoseStamped": (_of_pose_stamped, _pose),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (_of_pose_with_covariance, _pose),
    "geometry_msgs/msg/TransformStamped": (_of_transform, _pose),
    "geometry_msgs/msg/TwistStamped": (_of_twist, _twist),
    "sensor_msgs/msg/BatteryState": (_of_battery, _battery),
    "mavros_msgs/msg/State": (_of_state, _state),
    "mavros_msgs/msg/ExtendedState": (_of_extended_state, _extended_state),
    "mavros_msgs/msg/AttitudeTarget": (_of_attitude_target, _attitude_target),
    "mavros_msgs/msg/RCOut": (_of_pulses, _pulses),
    "mavros_msgs/msg/ESCTelemetry": (_of_esc, _esc),
    "mavros_msgs/msg/ESCStatus": (_of_esc, _esc),
    "mav_msgs/msg/Actuators": (_of_actuators, _actuators),
}
