"""Bags of ROS 1 and ROS 2, read without ROS (rosbags).

World frames of ROS are ENU and bodies FLU (REP 103), but the twist of an Odometry may be in either, and some vehicles
publish an IMU in FRD: what the convention leaves open is detected by the bag's own motion and noted.

The paper's published bags (PI-TCN) are recognised by their three topics, `odom`, `imu` and `motor_rpm` under one
vehicle's namespace: there the velocity is in the world and the IMU's rates are FRD.

Topics of px4_msgs are read as a ULog's (`px4_messages`). Only messages of a flight's topics are decoded.
"""

from __future__ import annotations

import sqlite3
import struct
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag1 import ReaderError as Reader1Error
from rosbags.rosbag2 import ReaderError as Reader2Error
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_typestore

from dynamics.errors import DataError
from flights.assembly import Assembly
from flights.log import LogContent
from flights.readers import px4_messages
from flights.readers.bag_clocks import clocks_of
from flights.readers.bag_limits import limits_of
from flights.readers.px4_messages import Px4Samples
from flights.readers.ros_messages import CONVERTERS, Samples, rotor_fields
from flights.readers.unused_topics import UnusedTopics, is_decodable, keep_undefined
from flights.source import Source, TimeSpan

_ROS1 = b"#ROSBAG V2.0"
_ANY_ROS1 = b"#ROSBAG"
_SQLITE = b"SQLite format 3\0"
_MCAP = b"\x89MCAP0\r\n"
_SUFFIXES = {_ROS1: ".bag", _SQLITE: ".db3", _MCAP: ".mcap"}
_BROKEN = (
    AnyReaderError,
    Reader1Error,
    Reader2Error,
    SerdeError,
    TypesysError,
    sqlite3.Error,
    struct.error,
    ValueError,
    KeyError,
    IndexError,
    EOFError,
    AssertionError,
    UnicodeDecodeError,
    NotImplementedError,
)
_PAPER_TOPICS = ("odom", "imu", "motor_rpm")
_MAX_NAMED = 12  # topics of a note
_OF_ANOTHER = "it is of another vehicle; --system N reads that whose namespace ends in N"


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is a bag of ROS 2."""
    return path.is_dir() and (path / "metadata.yaml").is_file()


def is_ros2_mcap(head: bytes) -> bool:
    """Whether the header of an MCAP file names the profile of ROS 2."""
    return head.startswith(_MCAP) and head[17:25] == (4).to_bytes(4, "little") + b"ros2"


def matches(source: Source) -> bool:
    """Whether it is a ROS 1 bag of any version, a ROS 2 bag's folder, or its storage by itself."""
    if source.is_folder:
        return is_bag_folder(source.file)
    return source.head.startswith((_ANY_ROS1, _SQLITE)) or is_ros2_mcap(source.head)


def read(source: Source) -> LogContent:
    """The streams of a bag. Raises DataError for a version or a storage that cannot be read."""
    if source.head.startswith(_ANY_ROS1) and not source.head.startswith(_ROS1):
        version = source.head.split(b"\n", 1)[0].decode("ascii", "replace")
        raise DataError(f"this is a bag of another version ({version}); wanted #ROSBAG V2.0. Use `rosbag migrate`.")
    assembly = Assembly()
    store = get_typestore(Stores.ROS2_HUMBLE)  # for older bags of ROS 2, without definitions in them
    try:
        with (
            limits_of(source.path),
            _named(source) as path,
            AnyReader([path], default_typestore=store) as reader,
        ):
            _read_topics(reader, assembly, source.span)
    except _BROKEN as error:
        raise DataError(
            f"this bag cannot be read: {error}. If it was cut off, `rosbag reindex` or `ros2 bag reindex` mends it."
        ) from None
    return assembly.finish()


@contextmanager
def _named(source: Source) -> Iterator[Path]:
    """A path with the suffix by which rosbags recognises the storage."""
    if source.is_folder:
        yield source.file
        return
    suffix = next(suffix for magic, suffix in _SUFFIXES.items() if source.head.startswith(magic))
    with tempfile.TemporaryDirectory(prefix="alula-") as folder:
        link = Path(folder) / f"bag{suffix}"
        link.symlink_to(source.file.resolve())
        yield link


def _read_topics(reader: AnyReader, assembly: Assembly, span: TimeSpan | None) -> None:
    connections = [connection for connection in reader.connections if _is_flight_data(connection, reader)]
    paper = _paper_namespace(connections)
    if paper is not None:
        assembly.metadata["data_set"] = "PI-TCN"
        assembly.note(
            f"this is a bag of the paper's set: {paper}odom has the velocity in the world, {paper}imu its rates in "
            "FRD, and rpm_0 to rpm_3 are rotors 0 to 3"
        )
    skipped = [c for c in reader.connections if c not in connections]
    _note_skipped(skipped, reader, assembly)
    of_one = _of_one_vehicle(connections, assembly)
    others = {c.topic: _OF_ANOTHER for c in connections if c not in of_one}
    definitions = reader.typestore.fielddefs
    connections = _with_definitions(of_one, reader, assembly)
    keep_undefined(assembly, reader.connections, definitions)
    unused = UnusedTopics([*skipped, *(c for c in reader.connections if c.topic in others)], definitions)
    if not connections and not unused.connections:  # for which rosbags would read every message, cameras' as well
        return
    samples = _samples(reader, [*connections, *unused.connections], unused, assembly, span)
    px4_messages.add_streams(assembly, {topic: rows for topic, rows in samples.items() if isinstance(rows, Px4Samples)})
    stamped = {topic: rows for topic, rows in samples.items() if isinstance(rows, Samples) and len(rows)}
    clocks = clocks_of(
        {topic: np.array(rows.stamps) for topic, rows in stamped.items()},
        {topic: np.array(rows.recorded) for topic, rows in stamped.items()},
        assembly,
    )
    for topic in sorted(stamped, key=_preference):
        stamped[topic].convert(assembly, topic, clocks[topic], is_paper=paper is not None)
    unused.keep(assembly, others)
    if span is None:  # a span of it would choose otherwise than the next one
        assembly.settle_rivals()


def _note_skipped(skipped: Sequence[Connection], reader: AnyReader, assembly: Assembly) -> None:
    """Note the topics that no convention reads, apart from those that are not even decoded."""
    definitions = reader.typestore.fielddefs
    for is_decoded, text in ((True, "are none of a flight's quantities"), (False, "are not decoded")):
        topics = {f"{c.topic} ({c.msgtype})" for c in skipped if is_decodable(c.msgtype, definitions) is is_decoded}
        if topics:
            more = f" and {len(topics) - _MAX_NAMED} more" if len(topics) > _MAX_NAMED else ""
            assembly.note(f"topics that {text}: {', '.join(sorted(topics)[:_MAX_NAMED])}{more}")


def _samples(
    reader: AnyReader, connections: list[Connection], unused: UnusedTopics, assembly: Assembly, span: TimeSpan | None
) -> dict[str, Samples | Px4Samples]:
    """The numbers of the topics that a convention reads; those of the others go to `unused`."""
    samples: dict[str, Samples | Px4Samples] = {}
    unread = {connection.topic for connection in unused.connections}
    start, stop = None, None
    if span is not None:
        start, stop = (reader.start_time + round(edge * 1e9) for edge in (span.start, span.end))
        span.following = span.end if reader.end_time > stop else span.following
    for connection, stamp, raw in reader.messages(connections=connections, start=start, stop=stop):
        if connection.topic in unread:
            if unused.is_wanted(connection.topic, raw):
                with suppress(AnyReaderError, KeyError, ValueError, AttributeError, IndexError):
                    unused.add(connection.topic, reader.deserialize(raw, connection.msgtype))
            continue
        rows = samples.get(connection.topic)
        if rows is None:
            is_px4 = px4_messages.is_read(connection.topic, connection.msgtype)
            rows = samples[connection.topic] = Px4Samples() if is_px4 else Samples(connection.msgtype)
        try:
            rows.add(stamp, reader.deserialize(raw, connection.msgtype))
        except (AnyReaderError, KeyError, ValueError, AttributeError, IndexError) as error:
            assembly.repair(
                "damaged_messages", f"{connection.topic}: messages that cannot be decoded left out ({error})"
            )
    return samples


def _of_one_vehicle(connections: list[Connection], assembly: Assembly) -> list[Connection]:
    """Connections without the PX4 topics of further vehicles."""
    of_px4 = [c.topic for c in connections if px4_messages.is_read(c.topic, c.msgtype)]
    if not of_px4:
        return connections
    space = px4_messages.chosen_vehicle(of_px4, assembly)
    return [c for c in connections if c.topic not in of_px4 or px4_messages.namespace(c.topic) == space]


def _with_definitions(connections: list[Connection], reader: AnyReader, assembly: Assembly) -> list[Connection]:
    """Connections whose messages can be decoded: SQLite bags of ROS 2 Humble and before hold no definitions."""
    without = [c for c in connections if c.msgtype not in reader.typestore.fielddefs]
    if without:
        topics = ", ".join(sorted(f"{c.topic} ({c.msgtype})" for c in without)[:12])
        assembly.note(
            f"the bag holds no definitions of its messages, without which {topics} cannot be decoded: convert it where "
            "these messages are installed (`ros2 bag convert`, storage_id mcap), or record MCAP"
        )
    return [c for c in connections if c not in without]


def _is_flight_data(connection: Connection, reader: AnyReader) -> bool:
    if connection.msgtype in CONVERTERS or px4_messages.is_read(connection.topic, connection.msgtype):
        return True
    if connection.msgtype.startswith(px4_messages.PACKAGE):
        return False
    definition = reader.typestore.fielddefs.get(connection.msgtype)
    return definition is not None and bool(rotor_fields([name for name, _ in definition[1]]))


def _paper_namespace(connections: Sequence[Connection]) -> str | None:
    """The namespace under which all of the paper's topics are, None in any other bag."""
    topics: set[str] = {connection.topic for connection in connections}
    for topic in topics:
        space = topic.removesuffix(_PAPER_TOPICS[2])
        if topic == f"{space}{_PAPER_TOPICS[2]}" and all(f"{space}{name}" in topics for name in _PAPER_TOPICS):
            return space
    return None


def _preference(topic: str) -> tuple[bool, bool, str]:
    """Estimates of the vehicle's own before what was commanded or set, then by name."""
    return "setpoint" in topic or "command" in topic, "mocap" in topic or "vicon" in topic, topic
