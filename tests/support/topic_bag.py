"""Bags of topics that are no convention's: any message type, numbers by field."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dynamics.arrays import Floats

RECORDED = 1_760_000_000_000_000_000  # ns since 1970 at time 0


@dataclass(frozen=True)
class BagTopic:
    """One topic.

    kind: message type, as rosbags spells it.
    message: of a store of types and a row's number.
    definition: of a type that ROS does not have.
    """

    name: str
    kind: str
    message: Callable[[Any, int], Any]
    definition: str = ""


def topic_bag(time: Floats, topics: Sequence[BagTopic], path: Path, storage: StoragePlugin | None = None) -> Path:
    """A bag with a message of each topic at each time. storage: None for ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC if storage is None else Stores.ROS2_HUMBLE)
    for topic in topics:
        if topic.definition:
            store.register(get_types_from_msg(topic.definition, topic.kind))
    with Writer1(path) if storage is None else Writer2(path, version=9, storage_plugin=storage) as bag:
        connections = {topic.name: bag.add_connection(topic.name, topic.kind, typestore=store) for topic in topics}
        serialize = store.serialize_ros1 if storage is None else store.serialize_cdr
        for row, at in enumerate(time):
            for topic in topics:
                raw = bytes(serialize(topic.message(store.types, row), topic.kind))
                bag.write(connections[topic.name], RECORDED + round(at * 1e9), raw)
    return path


def array_of(types: Any, kind: str, values: Any) -> Any:
    """A message of std_msgs with an array."""
    return types[kind](types["std_msgs/msg/MultiArrayLayout"]([], 0), values)


def header_of(types: Any, row: int, at: float) -> Any:
    """A header stamped at a time."""
    stamp = RECORDED + round(at * 1e9)
    header = types["std_msgs/msg/Header"]
    time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    fields = {"stamp": time, "frame_id": "world"}
    return header(seq=row, **fields) if "seq" in header.__dataclass_fields__ else header(**fields)


def pose_of(types: Any, row: int, at: float, position: Any, attitude: Any) -> Any:
    """A PoseStamped. attitude: w, x, y, z."""
    w, x, y, z = map(float, attitude)
    point = types["geometry_msgs/msg/Point"](*map(float, position))
    pose = types["geometry_msgs/msg/Pose"](point, types["geometry_msgs/msg/Quaternion"](x, y, z, w))
    return types["geometry_msgs/msg/PoseStamped"](header_of(types, row, at), pose)


def decoded_types(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The types of the messages that are decoded from now on, one for each message."""
    decoded: list[str] = []
    usual = AnyReader.deserialize

    def deserialize(self: AnyReader, raw: bytes, kind: str) -> Any:
        decoded.append(kind)
        return usual(self, raw, kind)

    monkeypatch.setattr(AnyReader, "deserialize", deserialize)
    return decoded
