"""Alula's own recordings: MCAP with JSON messages, read by scanning, so that a torn one is read up to its end."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator, Mapping, Sequence

import msgspec
import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader
from zstandard import ZstdError

from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.mcap_chunks import records_of
from flights.assembly import Assembly
from flights.log import LogContent
from flights.readers import rosbag
from flights.readers.px4_rotors import QUAD_X, add_servo_outputs, in_our_order, join_groups
from flights.source import Source, TimeSpan

MAGIC = b"\x89MCAP0\r\n"
# what reading a torn file raises; OverflowError and MemoryError: a damaged length field
TORN = (McapError, struct.error, ValueError, ZstdError, EOFError, OverflowError, MemoryError)

Numbers = Sequence[float | None]


class _Estimate(msgspec.Struct):
    time: float
    position_world: Numbers
    velocity_world: Numbers
    attitude: Numbers
    rate_body: Numbers
    reset_counter: int


class _Reference(msgspec.Struct):
    time: float
    position_world: Numbers
    velocity_world: Numbers
    attitude: Numbers


class _Setpoint(msgspec.Struct):
    time: float
    rate_body: Numbers
    collective_thrust: float | None
    thrust: float | None


class _Imu(msgspec.Struct):
    time: float
    specific_force_body: Numbers
    rate_body: Numbers


class _Rotors(msgspec.Struct):
    time: float
    first: int
    speed: Numbers


class _Motors(msgspec.Struct):
    time: float
    pulse: Numbers


class _Battery(msgspec.Struct):
    time: float
    voltage: float | None
    current: float | None


class _Observation(msgspec.Struct):
    time: float
    armed: bool
    landed: bool


_Row = _Estimate | _Reference | _Setpoint | _Imu | _Rotors | _Motors | _Battery | _Observation

# topic: its struct, and the quantity of each field; of several for one quantity the first is used
_TOPICS: Mapping[str, tuple[type[_Row], Mapping[str, str]]] = {
    "/imu": (_Imu, {"specific_force_body": "specific_force", "rate_body": "rate"}),  # the estimate's rate is filtered
    "/estimate": (_Estimate, {"position_world": "position", "velocity_world": "velocity", "attitude": "attitude",
                              "rate_body": "rate", "reset_counter": "reset_counter"}),
    "/rotors": (_Rotors, {"first": "", "speed": "rotor_speed"}),
    "/motors": (_Motors, {"pulse": "rotor_command"}),
    "/battery": (_Battery, {"voltage": "battery_voltage", "current": "battery_current"}),
    "/reference": (_Reference, {"position_world": "position_setpoint", "velocity_world": "velocity_setpoint",
                                "attitude": "attitude_setpoint"}),
    "/setpoint": (_Setpoint, {"rate_body": "rate_setpoint", "thrust": "thrust_setpoint",
                              "collective_thrust": "collective_thrust_command"}),
    "/observation": (_Observation, {"armed": "armed", "landed": "landed"}),
}  # fmt: skip


class _Collected:
    """One topic's rows as flat numbers, so that a long recording stays small in memory."""

    def __init__(self, kind: type[_Row], fields: Mapping[str, str]) -> None:
        self._decoder = msgspec.json.Decoder(kind)
        self.time = array("d")
        self.fields = {field: array("d") for field in fields}

    def add(self, data: bytes) -> None:
        row = self._decoder.decode(data)
        self.time.append(row.time)
        for field, numbers in self.fields.items():
            value = getattr(row, field)
            values = value if isinstance(value, list) else (value,)
            numbers.extend(float("nan") if number is None else number for number in values)


def matches(source: Source) -> bool:
    """Whether it is an MCAP file that is no ROS 2 bag."""
    return source.head.startswith(MAGIC) and not rosbag.is_ros2_mcap(source.head)


def read(source: Source) -> LogContent:
    """The streams of a recording. Raises DataError for an MCAP file that is none of ours."""
    assembly = Assembly()
    collected = {topic: _Collected(kind, fields) for topic, (kind, fields) in _TOPICS.items()}
    topics, metadata = _resumed(source.span)
    complete, damaged = False, 0
    for part in _parts(source, topics, metadata):
        match part:
            case Channel():
                topics[part.id] = part.topic
            case Message() if (rows := collected.get(topics.get(part.channel_id, ""))) is not None:
                try:
                    rows.add(part.data)
                except (msgspec.MsgspecError, UnicodeDecodeError):
                    damaged += 1
            case Metadata() if part.name == "alula":
                metadata.update(part.metadata)
            case Footer():
                complete = True
            case _:
                pass
    complete = complete or (source.span is not None and source.span.more)
    if source.span is None and not metadata and not any(len(rows.time) for rows in collected.values()):
        raise DataError(
            f"this MCAP file has the topics {', '.join(sorted(topics.values())[:8]) or '(none)'}, and none of a "
            "recording of `alula fly`. Bags of ROS 2 are read as well."
        )
    if not complete:
        assembly.repair("torn_end", "the recording was cut off, as by a crash; read up to its last whole chunk")
    if damaged:
        assembly.repair("damaged_messages", f"{damaged} messages that cannot be decoded left out")
    assembly.metadata.update({key: value for key, value in metadata.items() if len(value) < 1000})
    for topic, rows in collected.items():
        if topic == "/rotors":
            _add_rotors(assembly, rows)
        elif topic == "/motors":
            _add_motors(assembly, rows)
        else:
            _add_topic(assembly, topic, rows)
    return assembly.finish()


def _add_topic(assembly: Assembly, topic: str, rows: _Collected) -> None:
    time = np.array(rows.time)
    for field, name in _TOPICS[topic][1].items():
        values: Floats = np.array(rows.fields[field])
        if len(time) and len(values) % len(time) == 0:
            assembly.add(name, time, values.reshape(len(time), -1), topic)
        elif len(time):
            assembly.note(f"{topic}.{field} changes its length and is left out")


def _add_rotors(assembly: Assembly, rows: _Collected) -> None:
    time, speed = np.array(rows.time), np.array(rows.fields["speed"])
    if not len(time) or len(speed) % len(time):
        return
    time, speed = join_groups(time, np.array(rows.fields["first"]), speed.reshape(len(time), -1))
    order = QUAD_X if speed.shape[1] == len(QUAD_X) else None
    assembly.note(
        "rotor speeds are the autopilot's, put in our order as PX4's quad x"
        if order
        else f"rotor speeds are the autopilot's, {speed.shape[1]} motors left in its order"
    )
    assembly.add("rotor_speed", time, in_our_order(speed, order), "/rotors")


def _add_motors(assembly: Assembly, rows: _Collected) -> None:
    time, pulses = np.array(rows.time), np.array(rows.fields["pulse"])
    if not len(time) or len(pulses) % len(time):
        return
    add_servo_outputs(assembly, time, pulses.reshape(len(time), -1), "/motors")


def _resumed(span: TimeSpan | None) -> tuple[dict[int, str], dict[str, str]]:
    """Topics by channel, and metadata, from before a span."""
    if span is None or span.place is None:
        return {}, {}
    return dict(span.place[1]), dict(span.place[2])


def _parts(source: Source, topics: Mapping[int, str], metadata: Mapping[str, str]) -> Iterator[McapRecord]:
    """Records up to the end of the file or of a span, or to where the file is torn; chunks as their records."""
    span = source.span
    with source.file.open("rb") as stream:
        place = 0 if span is None or span.place is None else span.place[0]
        stream.seek(place)
        try:
            for part in StreamReader(stream, skip_magic=place > 0, emit_chunks=True).records:
                for record in records_of(part, source.path) if isinstance(part, Chunk) else [part]:
                    if span is None or not isinstance(record, Message):
                        yield record
                        continue
                    span.origin = float(record.log_time) if span.origin is None else span.origin
                    elapsed = (record.log_time - int(span.origin)) * 1e-9
                    if not span.more and elapsed >= span.end:
                        span.place = (place, dict(topics), dict(metadata))
                    if span.holds(elapsed):
                        yield record
                    elif span.is_past(elapsed):
                        return
                place = stream.tell()
        except TORN:
            return
