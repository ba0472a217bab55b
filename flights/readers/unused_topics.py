"""Topics of a bag that no convention reads: their numbers, of every n-th message, and what they may be.

Bulk (images, clouds, maps) is never decoded: a type with a sequence of bytes, or of messages without end, and a
message beyond MAX_BYTES.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from typing import Any

import numpy as np
from rosbags.interfaces import Connection, Nodetype

from dynamics.arrays import Floats
from flights.assembly import Assembly
from flights.readers.unused_groups import MAX_NUMBERS, keep_groups

MAX_BYTES = 4096  # of a message
MAX_ROWS = 500  # of a topic
MAX_MESSAGES = 4_000  # of all topics: a tenth of a second
MAX_TOPICS = 64
_BYTES = frozenset({"byte", "char", "uint8", "int8", "octet"})
_BULK = re.compile(
    r"image|camera|cloud|points|lidar|scan|map|video|compressed|marker|grid|path|rosout|tf_?message|parameter|"
    r"diagnostic|/tf|clock|joy|log(?![a-z])",
    re.IGNORECASE,
)
_SKIPPED = re.compile(r"covariance|header|stamp|layout|timestamp|__msgtype__|seq$|^time", re.IGNORECASE)
_SCALARS = re.compile(r"std_msgs/msg/(Float|U?Int)\d+$")
_NUMBER = re.compile(r"\d+(?!.*\d)")

Definitions = Mapping[str, Any]
Message = Any  # an instance of a class that rosbags makes of a message's definition


def shown_type(kind: str) -> str:
    """A message type as ROS writes it."""
    return kind.replace("/msg/", "/")


def is_decodable(kind: str, definitions: Definitions) -> bool:
    """Whether a type may hold a vehicle's numbers: it is known, and no bulk."""
    return kind in definitions and not _BULK.search(kind) and not _is_bulk(kind, definitions, 0)


def _is_bulk(kind: str, definitions: Definitions, depth: int) -> bool:
    """Whether a type holds a sequence of bytes anywhere."""
    if kind not in definitions or depth > 6:
        return True
    return any(_holds_bytes(field, definitions, depth) for _, field in definitions[kind][1])


def _holds_bytes(field: Any, definitions: Definitions, depth: int) -> bool:
    node, detail = field
    if node == Nodetype.NAME:
        return _is_bulk(detail, definitions, depth + 1)
    if node == Nodetype.BASE:
        return False
    inner, length = detail
    if inner[0] == Nodetype.BASE:
        return inner[1][0] in _BYTES and (node == Nodetype.SEQUENCE or length > MAX_NUMBERS)
    return _holds_bytes(inner, definitions, depth)


class UnusedTopics:
    """Numbers of the topics that no convention reads."""

    def __init__(self, connections: Sequence[Connection], definitions: Definitions) -> None:
        unread = [c for c in connections if is_decodable(c.msgtype, definitions)]
        topics = list(dict.fromkeys(c.topic for c in unread))
        self.beyond = topics[MAX_TOPICS:]
        self.connections = [c for c in unread if c.topic not in self.beyond]
        self._kinds = {c.topic: c.msgtype for c in self.connections}
        counts = dict.fromkeys(self._kinds, 0)
        for connection in self.connections:
            counts[connection.topic] += connection.msgcount
        self._counts = counts
        rows = min(MAX_ROWS, MAX_MESSAGES // max(1, len(counts)))
        self._steps = {topic: -(-count // rows) or 1 for topic, count in counts.items()}
        self._passed = dict.fromkeys(self._kinds, 0)
        self._names: dict[str, tuple[str, ...]] = {}
        self._rows: dict[str, array[float]] = {}

    def is_wanted(self, topic: str, raw: bytes) -> bool:
        """Whether the next message of a topic is to be decoded."""
        passed = self._passed[topic]
        self._passed[topic] += 1
        if len(raw) > MAX_BYTES or self._names.get(topic) == ():
            return False
        return passed % self._steps[topic] == 0

    def add(self, topic: str, message: Message) -> None:
        """Add a message's numbers; a topic with too many of them is left."""
        numbers = dict(_numbers("", message, []))
        if topic not in self._names:
            self._names[topic] = tuple(numbers) if len(numbers) < MAX_NUMBERS else ()
            self._rows[topic] = array("d")
        if self._names[topic] and tuple(numbers) == self._names[topic]:
            self._rows[topic].extend(numbers.values())

    def keep(self, assembly: Assembly, reasons: Mapping[str, str] | None = None) -> set[str]:
        """Keep as unused what may be a flight's quantity; the topics of which something was.

        reasons: why a topic is not read, where a convention would.
        """
        listed: set[str] = set()
        scalars: dict[str, list[str]] = {}
        for topic, names in self._names.items():
            if not names or not len(self._rows[topic]):
                continue
            table = np.array(self._rows[topic]).reshape(-1, len(names))
            kind = self._kinds[topic]
            if _SCALARS.match(kind) and _NUMBER.search(topic):
                scalars.setdefault(_NUMBER.sub("#", topic), []).append(topic)
                continue
            shown = [_shown_field(name) for name in names]
            words = (topic.rpartition("/")[2], kind.rpartition("/")[2].removesuffix("Stamped"), topic)
            source = f"{topic} ({shown_type(kind)})"
            reason = (reasons or {}).get(topic, "")
            if keep_groups(assembly, source, shown, table, words=words, reason=reason, count=self._counts[topic]):
                listed.add(topic)
        for pattern, topics in scalars.items():
            if len(topics) > 1 and self._keep_scalars(assembly, pattern, sorted(topics)):
                listed |= set(topics)
        return listed

    def _keep_scalars(self, assembly: Assembly, pattern: str, topics: Sequence[str]) -> bool:
        """Keep topics of one number each, told apart by a number in their names, as one group."""
        columns = [np.array(self._rows[topic]) for topic in topics]
        rows = min(len(column) for column in columns)
        table: Floats = np.stack([column[:rows] for column in columns], axis=1)
        source = f"{pattern} ({shown_type(self._kinds[topics[0]])})"
        count = min(self._counts[topic] for topic in topics)
        return keep_groups(assembly, source, topics, table, words=(pattern,), count=count)


def keep_undefined(assembly: Assembly, connections: Sequence[Connection], definitions: Collection[str]) -> None:
    """Keep as unused the topics whose type the bag does not define: what they hold is not known."""
    counts: dict[tuple[str, str], int] = {}
    for connection in connections:
        text = f"{connection.topic} {connection.msgtype}"
        if connection.msgtype not in definitions and not _BULK.search(text):
            key = (connection.topic, connection.msgtype)
            counts[key] = counts.get(key, 0) + connection.msgcount
    for (topic, kind), count in counts.items():
        reason = "the bag holds no definition of this message type, so that it cannot be decoded"
        assembly.leave_out_undecoded("rotor_speed", f"{topic} ({shown_type(kind)})", count, reason)


def _shown_field(name: str) -> str:
    return f"element[{name[5:-1]}]" if re.fullmatch(r"data\[\d+\]", name) else name


def _numbers(prefix: str, value: Any, counted: list[int]) -> Iterator[tuple[str, float]]:
    """A message's numbers by path, MAX_NUMBERS at most; no stamps, covariances and flags."""
    if len(counted) >= MAX_NUMBERS or (prefix and _SKIPPED.search(prefix.rpartition(".")[2])):
        return
    if is_dataclass(value):
        for field in value.__dataclass_fields__:
            if not field.startswith("__"):
                yield from _numbers(f"{prefix}.{field}" if prefix else field, getattr(value, field), counted)
    elif isinstance(value, (list, tuple, np.ndarray)):
        for index, item in enumerate(value[: MAX_NUMBERS + 1]):
            yield from _numbers(f"{prefix}[{index}]", item, counted)
    elif isinstance(value, (int, float, np.number)) and not isinstance(value, (bool, np.bool_)):
        counted.append(1)
        yield prefix, float(value)
