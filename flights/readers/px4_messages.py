"""Messages of px4_msgs in a bag of ROS 2, as the topics of a ULog: the same names, fields, units and frames.

uXRCE-DDS publishes uORB topics under `/fmu/out/` and takes those under `/fmu/in/`, after a vehicle's namespace if it
has one; a version may follow the name (`vehicle_status_v1`). Stamps are microseconds since the autopilot's boot, or
the computer's time where the two are synchronised.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynamics.recorded_vehicle import chosen_system
from flights.assembly import Assembly
from flights.readers import ulog
from flights.readers.px4_rotors import QUADROTOR
from flights.readers.ulog_topics import Topics

PACKAGE = "px4_msgs/msg/"
_TOPIC = re.compile(r"(?P<space>.*?)/?fmu/(?P<way>in|out)/\w+$")
_SAME_CLOCK = 1_000_000  # us between a stamp and its recording that a synchronised clock is within
_STAMPS = ("timestamp", "timestamp_sample")
_ROTORS_OF_QUADROTOR = 4

Message = Any  # an instance of a class that rosbags makes of a message's definition


@dataclass(frozen=True)
class _Logged:
    """One topic, as pyulog has them. data: columns by field."""

    name: str
    multi_id: int
    data: Mapping[str, NDArray[Any]]


def is_read(topic: str, kind: str) -> bool:
    """Whether a topic holds messages that become a flight's quantities. kind: message type."""
    return kind.startswith(PACKAGE) and _uorb_name(topic) in ulog.TOPICS


def namespace(topic: str) -> str:
    """The vehicle's namespace, empty where it has none."""
    match = _TOPIC.match(topic)
    return "" if match is None else match["space"]


def _uorb_name(topic: str) -> str:
    return re.sub(r"_v\d+$", "", topic.rpartition("/")[2])


def _is_input(topic: str) -> bool:
    match = _TOPIC.match(topic)
    return match is not None and match["way"] == "in"


class Px4Samples:
    """The numbers of one topic's messages by field, flat, so that a long bag stays small in memory."""

    def __init__(self) -> None:
        self.recorded = array("q")
        self._columns: dict[str, array[float]] = {}

    def add(self, recorded: int, message: Message) -> None:
        """Add a message. recorded: its time in the bag, ns. Raises ValueError where it is unlike those before."""
        numbers = dict(_numbers("", message))
        if self.recorded and numbers.keys() != self._columns.keys():
            raise ValueError("its fields are not those of the messages before")
        for name, number in numbers.items():
            self._columns.setdefault(name, array("d")).append(number)
        self.recorded.append(recorded)

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """(n,) each field."""
        return {name: np.array(values) for name, values in self._columns.items()}


def _numbers(prefix: str, value: Any) -> Iterator[tuple[str, float]]:
    """A message's numbers, named as a ULog names them: `control[3]`, `esc[0].esc_rpm`."""
    if is_dataclass(value):
        for field in value.__dataclass_fields__:
            if not field.startswith("__"):
                yield from _numbers(f"{prefix}.{field}" if prefix else field, getattr(value, field))
    elif isinstance(value, (list, tuple, np.ndarray)):
        for index, item in enumerate(value):
            yield from _numbers(f"{prefix}[{index}]", item)
    elif isinstance(value, (bool, int, float, np.number, np.bool_)):
        yield prefix, float(value)


def add_streams(assembly: Assembly, samples: Mapping[str, Px4Samples]) -> None:
    """Add the streams of one vehicle's topics. samples: by topic.

    Of a topic that the autopilot publishes and takes, the published one is used.
    """
    published = {_uorb_name(topic) for topic in samples if not _is_input(topic)}
    used = {t: rows for t, rows in samples.items() if not (_is_input(t) and _uorb_name(t) in published)}
    columns = {topic: rows.columns() for topic, rows in used.items() if len(rows.recorded)}
    columns = {topic: fields for topic, fields in columns.items() if "timestamp" in fields}
    if not columns:
        return
    _set_clock(assembly, columns, used)
    logged = [_Logged(_uorb_name(topic), 0, fields) for topic, fields in columns.items()]
    assembly.labels |= {_uorb_name(topic): topic for topic in columns}
    topics = Topics(logged, assembly)
    vehicle_type = _vehicle_type(topics)
    assembly.metadata |= {"messages": "px4_msgs"} | (
        {} if vehicle_type is None else {"vehicle_type": str(vehicle_type)}
    )
    ulog.add_topics(assembly, topics, vehicle_type)


def _vehicle_type(topics: Topics) -> int | None:
    """MAV_TYPE by the vehicle's status; four motors are a quadrotor's, for a bag has no parameters."""
    status = topics.get("vehicle_status")
    if status is not None and status.has("system_type"):
        return int(status["system_type"][0])
    motors = topics.get("actuator_motors")
    if motors is not None and motors.has("control[0]"):
        count = int(np.isfinite(motors.array("control", 12)).any(axis=0).sum())
        return QUADROTOR if count == _ROTORS_OF_QUADROTOR else None
    return None


def _set_clock(
    assembly: Assembly, columns: Mapping[str, dict[str, NDArray[np.float64]]], samples: Mapping[str, Px4Samples]
) -> None:
    """Put all stamps on the recording's clock, as the bag's other topics are: one step for all that the autopilot says.

    The step is the shortest delay from stamp to recording. A stamp of the sample that is on another clock than that of
    the publication goes.
    """
    for fields in columns.values():
        sampled = fields.get("timestamp_sample")
        if sampled is not None and abs(float(np.median(fields["timestamp"] - sampled))) > _SAME_CLOCK:
            del fields["timestamp_sample"]
    delays = {
        topic: float(np.min(np.array(samples[topic].recorded) * 1e-3 - fields["timestamp"]))
        for topic, fields in columns.items()
    }
    own = min((delay for topic, delay in delays.items() if not _is_input(topic)), default=None)
    for topic, fields in columns.items():
        delay = delays[topic]
        if abs(delay) < _SAME_CLOCK:
            continue
        step = own if own is not None and abs(delay - own) < _SAME_CLOCK else delay
        for name in _STAMPS:
            if name in fields:
                fields[name] = np.rint(fields[name] + step)
        if not _is_input(topic):
            assembly.note(
                f"PX4's stamps count from its boot, {step * 1e-6:.3f} s before the recording's clock: that step, the "
                "shortest delay between them, is added to all of them"
            )
        else:
            assembly.note(f"{topic}: stamps of another clock, put on the recording's by {step * 1e-6:.3f} s")


def chosen_vehicle(topics: Iterable[str], assembly: Assembly) -> str:
    """The namespace of the PX4 vehicle to read: that of the system id that was chosen, or else the first by name."""
    spaces = sorted({namespace(topic) for topic in topics})
    system = chosen_system()
    chosen = next((space for space in spaces if system is not None and re.search(rf"\D{system}$", space)), spaces[0])
    if len(spaces) > 1:
        names = ", ".join(space or "/" for space in spaces)
        assembly.note(
            f"the bag holds {len(spaces)} PX4 vehicles ({names}); read: {chosen or '/'}. --system N reads the one "
            "whose namespace ends in N"
        )
    return chosen
