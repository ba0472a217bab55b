"""Topics of px4_msgs in bags of ROS 2 are read as a ULog's are, and what is no flight's is not decoded."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dynamics.errors import DataError
from dynamics.recorded_vehicle import system_chosen
from flights import Flight, Log, read_log
from flights.pose_source import source_of
from flights.stated_frame import stated_layout
from tests.support.flight_files import Truth, manoeuvre
from tests.support.px4_bag import RECORDED, px4_bag, write_mocap
from tests.support.topic_bag import decoded_types

SINGLE = 1e-5  # of single precision at these sizes


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre(duration=2.0, rate=50.0)


def _assert_motion(log: Log, truth: Truth, names: tuple[str, ...] = ("position", "velocity", "rate")) -> None:
    for name in (*names, "specific_force"):
        stream = log.stream(name)
        assert stream is not None, name
        np.testing.assert_allclose(stream.values, getattr(truth, name), atol=SINGLE)
        np.testing.assert_allclose(stream.time, truth.time, atol=1e-6)
    attitude = log.stream("attitude")
    assert attitude is not None
    np.testing.assert_allclose(np.abs(np.sum(attitude.values * truth.attitude, axis=1)), 1.0, atol=SINGLE)


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize("compression", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.STORAGE])
def test_odometry_imu_and_motors_of_px4_are_those_of_a_ulog(
    truth: Truth, tmp_path: Path, storage: StoragePlugin, compression: CompressionMode
) -> None:
    if storage is StoragePlugin.SQLITE3 and compression is CompressionMode.STORAGE:
        compression = CompressionMode.MESSAGE
    log = read_log(px4_bag(truth, tmp_path / "bag", storage=storage, compression=compression))
    _assert_motion(log, truth)
    command = log.stream("rotor_command")
    assert command is not None
    np.testing.assert_allclose(command.values, truth.rotor_speed / 2000.0, atol=SINGLE)
    assert source_of(log.metadata) == "estimator"
    assert command.source == "/fmu/out/actuator_motors"


def test_a_namespace_versioned_names_and_esc_telemetry(truth: Truth, tmp_path: Path) -> None:
    messages = ("VehicleLocalPosition", "VehicleAttitude", "SensorCombined", "EscStatus", "VehicleStatus")
    log = read_log(px4_bag(truth, tmp_path / "bag", messages, spaces=("/px4_1",)))
    _assert_motion(log, truth)
    speed = log.stream("rotor_speed")
    assert speed is not None
    np.testing.assert_allclose(speed.values, truth.rotor_speed, atol=0.06)  # whole revolutions a minute
    armed = log.stream("armed")
    assert armed is not None
    assert armed.values.all()
    assert [event.text for event in log.events] == ["Offboard"]


def test_a_velocity_on_the_body_is_turned_into_the_world(truth: Truth, tmp_path: Path) -> None:
    _assert_motion(read_log(px4_bag(truth, tmp_path / "bag", body_velocity=True)), truth)


@pytest.mark.parametrize("boot", [90_000_000, RECORDED // 1000])
def test_stamps_since_boot_and_synchronised_ones_lie_on_the_clock_of_the_other_topics(
    truth: Truth, tmp_path: Path, boot: int
) -> None:
    log = read_log(px4_bag(truth, tmp_path / "bag", boot=boot, mocap=True))
    position = {stream.source: stream for stream in log.alternatives("position")}
    np.testing.assert_allclose(position["/fmu/out/vehicle_odometry"].time, position["/vrpn/uav/pose"].time, atol=0.0025)
    assert any("count from its boot" in note for note in log.provenance.notes) == (boot != RECORDED // 1000)


def test_one_vehicle_of_several_is_read_and_the_others_are_named(truth: Truth, tmp_path: Path) -> None:
    path = px4_bag(truth, tmp_path / "bag", spaces=("/px4_1", "/px4_2"))
    log = read_log(path)
    _assert_motion(log, truth)
    assert any("2 PX4 vehicles (/px4_1, /px4_2); read: /px4_1" in note for note in log.provenance.notes)
    with system_chosen(2):
        other = read_log(path).stream("position")
    assert other is not None
    np.testing.assert_allclose(other.values, truth.position + 100.0, atol=1e-4)


def test_motors_in_our_order_are_not_put_in_order_twice(truth: Truth, tmp_path: Path) -> None:
    layout = stated_layout([Flight.read(px4_bag(truth, tmp_path / "bag"))], "quad_x")
    assert layout.autopilot == "PX4"
    assert [tuple(np.sign(place[:2])) for place in layout.position] == [(1, 1), (-1, 1), (-1, -1), (1, -1)]


@pytest.mark.parametrize("with_pose", [True, False])
@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_images_are_not_decoded(
    truth: Truth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, with_pose: bool, storage: StoragePlugin
) -> None:
    """Of a bag with cameras only the flight's topics are decoded; of one with cameras alone, nothing."""
    path = _camera_bag(tmp_path / "bag", truth if with_pose else None, storage)
    decoded = decoded_types(monkeypatch)
    if with_pose:
        assert read_log(path).stream("position") is not None
        assert set(decoded) == {"geometry_msgs/msg/PoseStamped"}
    else:
        with pytest.raises(DataError, match=r"without flight data.*/camera/image_raw \(sensor_msgs/msg/Image\)"):
            read_log(path)
        assert decoded == []


def _camera_bag(path: Path, truth: Truth | None, storage: StoragePlugin) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    types, kind = store.types, "sensor_msgs/msg/Image"
    stamp: Any = types["builtin_interfaces/msg/Time"](sec=1, nanosec=0)
    header: Any = types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera")
    image: Any = types[kind](header, 1080, 1920, "rgb8", 0, 5760, np.zeros(1080 * 5760, np.uint8))
    with Writer2(path, version=9, storage_plugin=storage) as bag:
        connection = bag.add_connection("/camera/image_raw", kind, typestore=store)
        for number in range(3):
            bag.write(connection, RECORDED + number, bytes(store.serialize_cdr(image, kind)))
        if truth is not None:
            write_mocap(bag, store, truth)
    return path


def test_a_bag_without_definitions_says_what_is_missing(truth: Truth, tmp_path: Path) -> None:
    """As ROS 2 Humble's recorder writes SQLite."""
    bag = px4_bag(truth, tmp_path / "bag", storage=StoragePlugin.SQLITE3)
    with sqlite3.connect(next(bag.glob("*.db3"))) as database:
        database.execute("delete from message_definitions")
    database.close()
    with pytest.raises(DataError, match=r"no definitions of its messages.*/fmu/out/actuator_motors.*ros2 bag convert"):
        read_log(bag)


def test_pulses_of_mavros_are_rotor_commands(truth: Truth, tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "mavros_msgs/msg/RCOut"
    store.register(get_types_from_msg("std_msgs/Header header\nuint16[] channels", kind))
    swing = 150.0 * np.sin(3.0 * truth.time)[:, None] * np.array([1.0, -0.8, 0.9, -1.0])
    pulses = np.rint(1450.0 + swing).astype(np.uint16)
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/mavros/rc/out", kind, typestore=store)
        for time, row in zip(truth.time, pulses, strict=True):
            ns = RECORDED + round(time * 1e9)
            stamp: Any = store.types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            header: Any = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            message: Any = store.types[kind](header, np.append(row, np.zeros(12, np.uint16)))
            bag.write(connection, ns, bytes(store.serialize_cdr(message, kind)))
    command = read_log(tmp_path / "bag").stream("rotor_command")
    assert command is not None
    np.testing.assert_allclose(command.values, (pulses - 1000.0) / 1000.0)
