"""Logs in foreign formats, made of one flight with ground truth."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY

UP = np.array([0.0, 0.0, 1.0])


class Truth(NamedTuple):
    """A flight in our frames. Rows along the first axis; rotor speeds rad/s."""

    time: Floats
    position: Floats
    velocity: Floats
    attitude: Floats
    rate: Floats
    specific_force: Floats
    rotor_speed: Floats


def manoeuvre(duration: float = 6.0, rate: float = 100.0) -> Truth:
    """A vehicle that circles while it yaws, tilted along its acceleration, so that a wrong frame shows."""
    t = np.arange(round(duration * rate) + 1) / rate
    fine = 1e-5

    def position(at: Floats) -> Floats:
        return np.stack([2.0 * np.cos(1.5 * at), 1.5 * np.sin(1.5 * at), 2.0 + 0.4 * np.sin(0.7 * at)], axis=-1)

    def velocity(at: Floats) -> Floats:
        return (position(at + fine) - position(at - fine)) / (2 * fine)

    def acceleration(at: Floats) -> Floats:
        return np.stack([-4.5 * np.cos(1.5 * at), -3.375 * np.sin(1.5 * at), -0.196 * np.sin(0.7 * at)], axis=-1)

    def attitude(at: Floats) -> Floats:
        force = acceleration(at) + GRAVITY * UP
        yaw = quaternion.from_euler(0 * at, 0 * at, 0.9 + 0.5 * at)
        thrust_axis = force / np.linalg.norm(force, axis=-1, keepdims=True)
        axis = np.cross(UP, thrust_axis)
        angle = np.arcsin(np.linalg.norm(axis, axis=-1, keepdims=True))
        tilt = quaternion.exponential(axis / np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12) * angle)
        return np.asarray(quaternion.multiply(tilt, yaw))

    step = quaternion.multiply(quaternion.conjugate(attitude(t - fine)), attitude(t + fine))
    turning = quaternion.logarithm(step) / (2 * fine)
    force = quaternion.rotate_inverse(attitude(t), acceleration(t) + GRAVITY * UP)
    speeds = 1200.0 + 100.0 * np.arange(4) + 20.0 * np.sin(t)[:, None]
    q = quaternion.continuous(attitude(t))
    return Truth(t, position(t), velocity(t), q, turning, np.asarray(force), speeds)


def flight_csv(truth: Truth, path: Path, **replaced: Floats) -> Path:
    """The flight CSV of a truth, columns of single quantities replaced."""
    names, columns = ["t"], [truth.time]
    for name in ("position", "velocity", "attitude", "rate", "specific_force", "rotor_speed"):
        values = replaced.get(name, getattr(truth, name))
        parts = {"attitude": "wxyz", "rotor_speed": "0123"}.get(name, "xyz")
        names += [f"{name}_{part}" for part in parts]
        columns += list(values.T)
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header=",".join(names), comments="", fmt="%.17g")
    return path


def crazyflie_log(
    variables: list[tuple[str, str]], rows: list[tuple[int, tuple[Any, ...]]], *, version: int = 2, name: str = "main"
) -> bytes:
    """A micro-SD log with one type of event. rows: ticks of the version's clock, and values."""
    head = struct.pack("<BHHH", 0xBC, version, 1, 0xFFFF) + name.encode() + b"\0" + struct.pack("<H", len(variables))
    head += b"".join(f"{variable}({letter})".encode() + b"\0" for variable, letter in variables)
    layout = struct.Struct("<H" + {1: "I", 2: "Q"}[version] + "".join(letter for _, letter in variables))
    body = head + b"".join(layout.pack(0xFFFF, ticks, *values) for ticks, values in rows)
    return body + struct.pack("<I", zlib.crc32(body))


MOTOR_RPM = "std_msgs/Header header\nfloat64 rpm_0\nfloat64 rpm_1\nfloat64 rpm_2\nfloat64 rpm_3\n"


def paper_bag(truth: Truth, path: Path, *, space: str = "/dragonfly17") -> Path:
    """A bag as the paper's published set has them: odom (velocity in the world), imu (rates FRD), motor_rpm."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(MOTOR_RPM, "quadrotor_msgs/msg/MotorRPM"))
    kinds = {
        "odom": "nav_msgs/msg/Odometry",
        "imu": "sensor_msgs/msg/Imu",
        "motor_rpm": "quadrotor_msgs/msg/MotorRPM",
    }
    with Writer1(path) as bag:
        topics = {name: bag.add_connection(f"{space}/{name}", kind, typestore=store) for name, kind in kinds.items()}
        rates = frames.flu_from_frd(truth.rate)
        for i, t in enumerate(truth.time):
            stamp = 1_600_000_000_000_000_000 + round(t * 1e9)
            messages = {
                "odom": _odometry(store, i, stamp, truth, truth.velocity[i]),
                "imu": _imu(store, i, stamp, rates[i], truth.specific_force[i]),
                "motor_rpm": store.types[kinds["motor_rpm"]](
                    _header(store, i, stamp), *(truth.rotor_speed[i] * 60 / (2 * np.pi))
                ),
            }
            for name, message in messages.items():
                raw = bytes(store.serialize_ros1(message, kinds[name]))
                bag.write(topics[name], stamp + 2_000_000, raw)
    return path


def ros2_bag(truth: Truth, path: Path, *, body_velocity: bool, storage: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    """A ROS 2 bag with an Odometry whose twist is in either frame, an Imu and a BatteryState."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    velocity = quaternion.rotate_inverse(truth.attitude, truth.velocity) if body_velocity else truth.velocity
    with Writer2(path, version=8, storage_plugin=storage) as bag:
        odometry = bag.add_connection("/odometry", "nav_msgs/msg/Odometry", typestore=store)
        imu = bag.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for i, t in enumerate(truth.time):
            stamp = 1_700_000_000_000_000_000 + round(t * 1e9)
            message = _odometry(store, i, stamp, truth, velocity[i])
            bag.write(odometry, stamp, bytes(store.serialize_cdr(message, "nav_msgs/msg/Odometry")))
            message = _imu(store, i, stamp, truth.rate[i], truth.specific_force[i])
            bag.write(imu, stamp, bytes(store.serialize_cdr(message, "sensor_msgs/msg/Imu")))
    return path


def _header(store: Any, count: int, stamp: int) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    header = store.types["std_msgs/msg/Header"]
    fields = {"stamp": time, "frame_id": "world"}
    return header(seq=count, **fields) if "seq" in header.__dataclass_fields__ else header(**fields)


def _vector(store: Any, values: Floats, kind: str = "Vector3") -> Any:
    return store.types[f"geometry_msgs/msg/{kind}"](*(float(value) for value in values))


def _odometry(store: Any, i: int, stamp: int, truth: Truth, velocity: Floats) -> Any:
    types, q = store.types, np.roll(truth.attitude[i], -1)
    pose = types["geometry_msgs/msg/Pose"](
        _vector(store, truth.position[i], "Point"), types["geometry_msgs/msg/Quaternion"](*map(float, q))
    )
    twist = types["geometry_msgs/msg/Twist"](_vector(store, velocity), _vector(store, np.zeros(3)))
    return types["nav_msgs/msg/Odometry"](
        _header(store, i, stamp),
        "base_link",
        types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
        types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
    )


def _imu(store: Any, i: int, stamp: int, rate: Floats, force: Floats) -> Any:
    """An IMU with an orientation of its own, whose heading nobody may take for the vehicle's."""
    types = store.types
    return types["sensor_msgs/msg/Imu"](
        _header(store, i, stamp),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 1.0, 0.0),
        np.zeros(9),
        _vector(store, rate),
        np.zeros(9),
        _vector(store, force),
        np.zeros(9),
    )


def dataflash_log(truth: Truth) -> bytes:
    """An ArduPilot log with the EKF's position, velocity and attitude, the IMU and ESC speeds."""
    formats = {
        "PARM": (129, "QNf", "TimeUS,Name,Value"),
        "XKF1": (130, "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
        "XKQ": (131, "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
        "IMU": (132, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        "ESC": (133, "QBf", "TimeUS,Instance,RPM"),
    }
    codes = {"Q": "Q", "B": "B", "f": "f", "N": "16s"}
    structs = {name: struct.Struct("<" + "".join(codes[c] for c in form)) for name, (_, form, _) in formats.items()}

    def record(name: str, *values: Any) -> bytes:
        return bytes([0xA3, 0x95, formats[name][0]]) + structs[name].pack(*values)

    data = struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    for name, (number, form, columns) in formats.items():
        size = structs[name].size + 3
        data += struct.pack(
            "<BBBBB4s16s64s", 0xA3, 0x95, 128, number, size, name.encode(), form.encode(), columns.encode()
        )
    for name, value in (("FRAME_CLASS", 1.0), ("FRAME_TYPE", 1.0)):
        data += record("PARM", 0, name.encode(), value)
    q = frames.attitude_ned_frd(truth.attitude)
    velocity, position = frames.enu_from_ned(truth.velocity), frames.enu_from_ned(truth.position)
    rate, force = frames.flu_from_frd(truth.rate), frames.flu_from_frd(truth.specific_force)
    # ArduPilot's quad x: motor 1 front right, 2 back left, 3 front left, 4 back right
    rpm = truth.rotor_speed[:, [3, 1, 0, 2]] * 60 / (2 * np.pi)
    for i, t in enumerate(truth.time):
        us = 5_000_000 + round(t * 1e6)
        data += record("XKF1", us, 0, *velocity[i], *position[i]) + record("XKQ", us, 0, *q[i])
        data += record("IMU", us, 0, *rate[i], *force[i])
        data += b"".join(record("ESC", us, esc, rpm[i, esc]) for esc in range(4))
    return data


def tlog(truth: Truth, *, body_velocity: bool = False) -> bytes:
    """A tlog of a vehicle's ODOMETRY and HIGHRES_IMU, one heartbeat a second, arriving 3 ms late."""
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    q = frames.attitude_ned_frd(truth.attitude)
    position, rate = frames.enu_from_ned(truth.position), frames.flu_from_frd(truth.rate)
    force = frames.flu_from_frd(truth.specific_force)
    velocity = frames.enu_from_ned(truth.velocity)
    child = mavlink.MAV_FRAME_LOCAL_NED
    if body_velocity:
        velocity = frames.flu_from_frd(quaternion.rotate_inverse(truth.attitude, truth.velocity))
        child = mavlink.MAV_FRAME_BODY_FRD
    data, unknown = b"", [float("nan")] * 21
    for i, t in enumerate(truth.time):
        us, stamp = 7_000_000 + round(t * 1e6), struct.pack(">Q", 1_700_000_000_000_000 + round(t * 1e6) + 3000)
        messages = [
            mavlink.MAVLink_odometry_message(
                us,
                mavlink.MAV_FRAME_LOCAL_NED,
                child,
                *position[i],
                [float(c) for c in q[i]],
                *velocity[i],
                *rate[i],
                unknown,
                unknown,
                9,
            ),
            mavlink.MAVLink_highres_imu_message(us, *force[i], *rate[i], 0, 0, 0, 0, 0, 0, 0, 63),
        ]
        if i % 100 == 0:
            messages.insert(0, mavlink.MAVLink_heartbeat_message(2, 12, 129, 0, 4, 3))
        data += b"".join(stamp + message.pack(link) for message in messages)
    return data
