"""Nothing is missing that a bag holds: numbers of topics that no convention names are kept with range and reason."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from dynamics.arrays import Floats
from flights import Log, read_log
from flights.log import UnusedStream
from flights.quality.inspection import judge
from tests.support.flight_files import Truth, manoeuvre
from tests.support.topic_bag import BagTopic, array_of, decoded_types, pose_of, topic_bag

MISSING = ("neither rotor speeds nor commands", "log them")
STORAGES = [None, *StoragePlugin]


@pytest.fixture(scope="module")
def truth() -> Truth:
    return manoeuvre(duration=12.0, rate=50.0)


def _pose(truth: Truth, name: str = "/vrpn/uav/pose", *, shift: float = 0.0, moving: bool = True) -> BagTopic:
    def message(types: Any, row: int) -> Any:
        at = row if moving else 0
        return pose_of(types, row, truth.time[row], truth.position[at] + shift, truth.attitude[at])

    return BagTopic(name, "geometry_msgs/msg/PoseStamped", message)


def _array(
    name: str, table: Floats, kind: str = "std_msgs/msg/Float32MultiArray", dtype: type = np.float32
) -> BagTopic:
    values = np.asarray(table, dtype=dtype)
    return BagTopic(name, kind, lambda types, row: array_of(types, kind, values[row]))


def _fields(name: str, kind: str, definition: str, *columns: Floats) -> BagTopic:
    return BagTopic(name, kind, lambda types, row: types[kind](*(float(c[row]) for c in columns)), definition)


def _of(log: Log, source: str) -> UnusedStream:
    matching = [unused for unused in log.provenance.unused if unused.source.startswith(source)]
    assert len(matching) == 1, log.provenance.unused
    return matching[0]


def _says_missing(log: Log) -> bool:
    inspection = judge(log)
    lines = [inspection.sentence, *(f.text + f.advice for f in inspection.findings)]
    return any(text in line for text in MISSING for line in lines)


@pytest.mark.parametrize("storage", STORAGES)
def test_rotor_speeds_of_a_plain_array_are_candidates(
    truth: Truth, tmp_path: Path, storage: StoragePlugin | None
) -> None:
    speeds = _array("/rotor_speeds", truth.rotor_speed)
    log = read_log(topic_bag(truth.time, [_pose(truth), speeds], tmp_path / ("bag" if storage else "a.bag"), storage))
    unused = _of(log, "/rotor_speeds (std_msgs/Float32MultiArray)")
    low, high = np.float32(truth.rotor_speed).min(), np.float32(truth.rotor_speed).max()
    assert str(unused).endswith(
        f"elements 0 to 3 move between {low:.6g} and {high:.6g}; not used: no convention says that it is rotors"
    )
    assert (unused.quantity, unused.moves, unused.count) == ("rotor_speed", True, len(truth.time))
    assert not _says_missing(log)


def _rotor_forms(truth: Truth) -> dict[str, tuple[list[BagTopic], str]]:
    speed, command = truth.rotor_speed, truth.rotor_speed / truth.rotor_speed.max()
    numbered = "".join(f"float64 m{n}\n" for n in range(1, 5))
    placed = "float64 front_left\nfloat64 front_right\nfloat64 rear_left\nfloat64 rear_right\n"
    kind = "std_msgs/msg/Float64"
    singles = [
        BagTopic(f"/uav/motor_speed/{n}", kind, lambda types, row, n=n: types[kind](float(speed[row, n])))
        for n in range(4)
    ]
    joints = "sensor_msgs/msg/JointState"

    def joint(types: Any, row: int) -> Any:
        header = pose_of(types, row, truth.time[row], np.zeros(3), (1, 0, 0, 0)).header
        names = [f"rotor_{n}_joint" for n in range(4)]
        return types[joints](header, names, np.zeros(4), speed[row] * np.array([1, -1, 1, -1]), np.zeros(4))

    return {
        "unnamed": ([_array("/debug/values", speed)], "rotor_speed"),
        "pulses": ([_array("/out", np.rint(1000 + 900 * command), "std_msgs/msg/UInt16MultiArray", np.uint16)],
                   "rotor_command"),
        "commands": ([_array("/cf/cmds", command)], "rotor_command"),
        "numbered": ([_fields("/mix", "own_msgs/msg/Mix", numbered, *speed.T)], "rotor_speed"),
        "placed": ([_fields("/thrusters", "own_msgs/msg/Four", placed, *command.T)], "rotor_command"),
        "scalars": (singles, "rotor_speed"),
        "joints": ([BagTopic("/joint_states", joints, joint)], "rotor_speed"),
    }  # fmt: skip


@pytest.mark.parametrize("form", ["unnamed", "pulses", "commands", "numbered", "placed", "scalars", "joints"])
def test_rotors_of_any_form_are_candidates(truth: Truth, tmp_path: Path, form: str) -> None:
    topics, quantity = _rotor_forms(truth)[form]
    log = read_log(topic_bag(truth.time, [_pose(truth), *topics], tmp_path / "bag", StoragePlugin.MCAP))
    (unused,) = log.provenance.candidates(["rotor_speed", "rotor_command"])
    assert unused.quantity == quantity
    assert len(unused.fields) == 4
    assert not _says_missing(log)


@pytest.mark.parametrize(
    ("name", "quantity"),
    [("specific_force", "specific_force"), ("rate", "rate"), ("attitude", "attitude"), ("position", "position")],
)
@pytest.mark.parametrize("as_array", [True, False])
def test_motion_that_no_convention_names_is_a_candidate(
    truth: Truth, tmp_path: Path, name: str, quantity: str, as_array: bool
) -> None:
    values = np.asarray(getattr(truth, name))
    topic = {"specific_force": "/imu/accel", "rate": "/imu/gyro", "attitude": "/q", "position": "/uav/position"}[name]
    axes = "xyz" if values.shape[1] == 3 else "wxyz"
    extra = (
        _array(topic, values, "std_msgs/msg/Float64MultiArray", np.float64)
        if as_array
        else _fields(topic, "own_msgs/msg/Sample", "".join(f"float64 {axis}\n" for axis in axes), *values.T)
    )
    log = read_log(topic_bag(truth.time, [_pose(truth), extra], tmp_path / "bag", StoragePlugin.MCAP))
    unused = _of(log, topic)
    assert (unused.quantity, unused.moves) == (quantity, True)


def test_a_row_of_several_quantities_is_told_apart_by_content(truth: Truth, tmp_path: Path) -> None:
    row = np.concatenate(
        [truth.position, truth.attitude, truth.velocity, truth.rotor_speed, truth.specific_force, truth.rate], axis=1
    )
    topics = [_pose(truth), _array("/row", row, "std_msgs/msg/Float64MultiArray", np.float64)]
    log = read_log(topic_bag(truth.time, topics, tmp_path / "bag", StoragePlugin.MCAP))
    first = {unused.quantity: unused.fields[0] for unused in log.provenance.unused}
    places = {"position": 0, "attitude": 3, "rotor_speed": 10, "specific_force": 14, "rate": 17}
    assert first == {name: f"element[{place}]" for name, place in places.items()}


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("still", ["/a/pose", "/z/pose"])
def test_a_topic_that_stands_still_never_wins_and_the_other_is_listed(
    truth: Truth, tmp_path: Path, still: str, storage: StoragePlugin | None
) -> None:
    topics = [_pose(truth, "/m/pose"), _pose(truth, still, moving=False)]
    log = read_log(topic_bag(truth.time, topics, tmp_path / ("bag" if storage else "a.bag"), storage))
    for name in ("position", "attitude"):
        stream = log.stream(name)
        assert stream is not None
        assert stream.source == "/m/pose"
        unused = [one for one in log.provenance.unused if one.source.startswith(still) and one.quantity == name]
        assert len(unused) == 1
        assert not unused[0].moves
        assert "stands still" in unused[0].reason


def test_a_second_topic_of_a_quantity_is_listed(truth: Truth, tmp_path: Path) -> None:
    topics = [_pose(truth, "/a/pose"), _pose(truth, "/b/pose", shift=3.0)]
    log = read_log(topic_bag(truth.time, topics, tmp_path / "bag", StoragePlugin.MCAP))
    listed = [unused for unused in log.provenance.unused if unused.source.startswith("/b/pose")]
    assert {unused.quantity for unused in listed} == {"position", "attitude"}
    assert all(unused.reason == f"{unused.quantity} is taken from /a/pose" for unused in listed)


def test_rotors_that_stand_still_do_not_hide_those_that_move(truth: Truth, tmp_path: Path) -> None:
    rpm = "".join(f"float64 rpm_{n}\n" for n in range(4))
    still = _fields("/esc", "own_msgs/msg/Rpm", rpm, *np.zeros_like(truth.rotor_speed).T)
    moving = _array("/rotor_speeds", truth.rotor_speed)
    log = read_log(topic_bag(truth.time, [_pose(truth), still, moving], tmp_path / "bag", StoragePlugin.MCAP))
    assert log.stream("rotor_speed") is None
    assert "stands still" in _of(log, "/esc").reason
    assert [one.source for one in log.provenance.candidates(["rotor_speed"])] == [
        "/rotor_speeds (std_msgs/Float32MultiArray)"
    ]


def test_types_without_a_definition_are_named_and_nothing_is_missing(truth: Truth, tmp_path: Path) -> None:
    numbered = "".join(f"float64 thing{n}\n" for n in range(4))
    topics = [_pose(truth), _fields("/plant", "own_msgs/msg/Unknown", numbered, *truth.rotor_speed.T)]
    path = topic_bag(truth.time, topics, tmp_path / "bag", StoragePlugin.SQLITE3)
    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.execute("delete from message_definitions")
    database.close()
    log = read_log(path)
    unused = _of(log, "/plant (own_msgs/Unknown)")
    assert (unused.fields, unused.count) == ((), len(truth.time))
    assert "definition" in str(unused)
    assert not _says_missing(log)
    assert any("/plant" in finding.text for finding in judge(log).findings)


def _bulk(kind: str) -> Callable[[Any, int], Any]:
    def message(types: Any, row: int) -> Any:
        header = pose_of(types, row, 0.0, np.zeros(3), (1, 0, 0, 0)).header
        if kind.endswith("PointCloud2"):
            return types[kind](header, 1, 50, [], False, 12, 600, np.zeros(600, np.uint8), True)
        return types[kind](header, 8, 8, "rgb8", 0, 24, np.zeros(192, np.uint8))

    return message


@pytest.mark.parametrize("kind", ["sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"])
def test_bulk_is_not_decoded_and_what_is_decoded_is_bounded(
    truth: Truth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    from flights.readers import unused_topics

    monkeypatch.setattr(unused_topics, "MAX_ROWS", 100)
    wide = _array("/grid", np.tile(np.sin(truth.time)[:, None], 900))
    topics = [_pose(truth), _array("/rotor_speeds", truth.rotor_speed), wide, BagTopic("/bulk", kind, _bulk(kind))]
    path = topic_bag(truth.time, topics, tmp_path / "bag", StoragePlugin.MCAP)
    decoded = decoded_types(monkeypatch)
    log = read_log(path)
    assert kind not in decoded
    assert 50 <= decoded.count("std_msgs/msg/Float32MultiArray") <= 100
    assert _of(log, "/rotor_speeds").count == len(truth.time)
    assert any("/bulk" in note and "not decoded" in note for note in log.provenance.notes)
    assert not any(unused.source.startswith("/grid") for unused in log.provenance.unused)


def test_a_bag_without_any_rotor_still_lacks_them(truth: Truth, tmp_path: Path) -> None:
    swing = np.sin(truth.time[:, None] * np.array([1.0, 1.7, 2.3, 0.4]))
    sticks = _array("/rc/sticks", 1500 + 300 * swing)
    setpoint = _array("/position_setpoint", truth.position)
    errors = _array("/controller/error", swing)
    log = read_log(topic_bag(truth.time, [_pose(truth), sticks, setpoint, errors], tmp_path / "b", StoragePlugin.MCAP))
    assert not log.provenance.candidates(["rotor_speed", "rotor_command"])
    assert _says_missing(log)
