"""Bags of ROS 2 with px4_msgs, made of a truth: NED, FRD, microseconds, the field names of PX4's own messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.autopilot_frames import QUAD_X_ORDER
from tests.support.flight_files import Truth

RECORDED = 1_760_000_000_000_000_000  # ns since 1970 at the truth's time 0
BOOT = 90_000_000  # us since boot at the truth's time 0
BODY_FRD, NED = 3, 1
DEFINITIONS: Mapping[str, str] = {
    "VehicleOdometry": "uint64 timestamp\nuint64 timestamp_sample\nuint8 pose_frame\nfloat32[3] position\n"
    "float32[4] q\nuint8 velocity_frame\nfloat32[3] velocity\nfloat32[3] angular_velocity\n"
    "uint8 reset_counter\nint8 quality",
    "VehicleLocalPosition": "uint64 timestamp\nuint64 timestamp_sample\nbool xy_valid\nbool z_valid\nbool v_xy_valid\n"
    "bool v_z_valid\nfloat32 x\nfloat32 y\nfloat32 z\nfloat32 vx\nfloat32 vy\nfloat32 vz",
    "VehicleAttitude": "uint64 timestamp\nuint64 timestamp_sample\nfloat32[4] q\nuint8 quat_reset_counter",
    "SensorCombined": "uint64 timestamp\nfloat32[3] gyro_rad\nuint32 gyro_integral_dt\n"
    "int32 accelerometer_timestamp_relative\nfloat32[3] accelerometer_m_s2\nuint32 accelerometer_integral_dt",
    "VehicleAngularVelocity": "uint64 timestamp\nuint64 timestamp_sample\nfloat32[3] xyz\nfloat32[3] xyz_derivative",
    "ActuatorMotors": "uint64 timestamp\nuint64 timestamp_sample\nuint16 reversible_flags\nfloat32[12] control",
    "EscReport": "uint64 timestamp\nint32 esc_rpm\nfloat32 esc_voltage\nuint8 actuator_function",
    "EscStatus": "uint64 timestamp\nuint16 counter\nuint8 esc_count\npx4_msgs/EscReport[8] esc",
    "VehicleStatus": "uint64 timestamp\nuint8 arming_state\nuint8 nav_state\nuint8 system_type",
}
NAMES: Mapping[str, str] = {  # topics of the messages, after the namespace
    "VehicleOdometry": "/fmu/out/vehicle_odometry",
    "VehicleLocalPosition": "/fmu/out/vehicle_local_position_v1",
    "VehicleAttitude": "/fmu/out/vehicle_attitude",
    "SensorCombined": "/fmu/out/sensor_combined",
    "VehicleAngularVelocity": "/fmu/out/vehicle_angular_velocity",
    "ActuatorMotors": "/fmu/out/actuator_motors",
    "EscStatus": "/fmu/out/esc_status",
    "VehicleStatus": "/fmu/out/vehicle_status_v1",
}
ODOMETRY = ("VehicleOdometry", "SensorCombined", "ActuatorMotors", "VehicleAngularVelocity")


def px4_store() -> Any:
    """A store of types with px4_msgs beside ROS 2's own."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, f"px4_msgs/msg/{name}"))
    return store


def px4_bag(
    truth: Truth,
    path: Path,
    messages: Sequence[str] = ODOMETRY,
    *,
    spaces: Sequence[str] = ("",),
    boot: int = BOOT,
    body_velocity: bool = False,
    storage: StoragePlugin = StoragePlugin.MCAP,
    compression: CompressionMode = CompressionMode.NONE,
    mocap: bool = False,
) -> Path:
    """A bag of these messages. boot: stamp of the truth's time 0, us. mocap: its pose as well, on the recorder's clock.

    spaces: namespaces of vehicles, of which all further ones fly elsewhere.
    """
    store = px4_store()
    bag = Writer2(path, version=9, storage_plugin=storage)
    if compression is not CompressionMode.NONE:
        bag.set_compression(compression, CompressionFormat.ZSTD)
    with bag:
        for number, space in enumerate(spaces):
            moved = truth._replace(position=truth.position + 100.0 * number)
            for name in messages:
                kind = f"px4_msgs/msg/{name}"
                connection = bag.add_connection(space + NAMES[name], kind, typestore=store)
                for i, time in enumerate(truth.time):
                    message = _message(store, name, boot + round(time * 1e6), moved, i, body_velocity)
                    raw = bytes(store.serialize_cdr(message, kind))
                    bag.write(connection, RECORDED + round(time * 1e9) + 2_000_000, raw)
        if mocap:
            write_mocap(bag, store, truth)
    return path


def write_mocap(bag: Writer2, store: Any, truth: Truth) -> None:
    """Add the truth's pose as motion capture publishes it, stamped by the recorder's clock."""
    kind, types = "geometry_msgs/msg/PoseStamped", store.types
    connection = bag.add_connection("/vrpn/uav/pose", kind, typestore=store)
    for time, position, attitude in zip(truth.time, truth.position, truth.attitude, strict=True):
        stamp = RECORDED + round(time * 1e9)
        at = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        pose = types["geometry_msgs/msg/Pose"](
            types["geometry_msgs/msg/Point"](*map(float, position)),
            types["geometry_msgs/msg/Quaternion"](*map(float, np.roll(attitude, -1))),
        )
        message = types[kind](types["std_msgs/msg/Header"](stamp=at, frame_id="world"), pose)
        bag.write(connection, stamp + 1_000_000, bytes(store.serialize_cdr(message, kind)))


def _single(values: Floats) -> Any:
    return np.asarray(values, dtype=np.float32)


def _message(store: Any, name: str, stamp: int, truth: Truth, i: int, body_velocity: bool) -> Any:
    """One message of PX4 at a row of the truth."""
    q = _single(frames.attitude_ned_frd(truth.attitude[i]))
    position, velocity = frames.enu_from_ned(truth.position[i]), frames.enu_from_ned(truth.velocity[i])
    body = frames.flu_from_frd(quaternion.rotate_inverse(truth.attitude[i], truth.velocity[i]))
    rate, force = _single(frames.flu_from_frd(truth.rate[i])), _single(frames.flu_from_frd(truth.specific_force[i]))
    motors = np.empty(4)
    motors[list(QUAD_X_ORDER)] = truth.rotor_speed[i]
    zero = np.zeros(3, np.float32)
    fields: dict[str, tuple[Any, ...]] = {
        "VehicleOdometry": (
            stamp, stamp, NED, _single(position), q, BODY_FRD if body_velocity else NED,
            _single(body if body_velocity else velocity), rate, 0, 0,
        ),
        "VehicleLocalPosition": (stamp, stamp, True, True, True, True, *map(float, [*position, *velocity])),
        "VehicleAttitude": (stamp, stamp, q, 0),
        "SensorCombined": (stamp, rate, 5000, 0, force, 5000),
        "VehicleAngularVelocity": (stamp, stamp, rate, zero),
        "ActuatorMotors": (stamp, stamp, 0, _single(np.append(motors / 2000.0, np.full(8, np.nan)))),
        "VehicleStatus": (stamp, 2, 14, 2),
    }  # fmt: skip
    types = store.types
    if name == "EscStatus":
        report = types["px4_msgs/msg/EscReport"]
        rpm = np.append(motors * 60 / (2 * np.pi), np.zeros(4))
        esc = [report(stamp, round(float(rpm[n])), 15.0, 101 + n if n < 4 else 0) for n in range(8)]
        return types["px4_msgs/msg/EscStatus"](stamp, i % 65536, 4, esc)
    return types[f"px4_msgs/msg/{name}"](*fields[name])
