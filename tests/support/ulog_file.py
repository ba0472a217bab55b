"""PX4 ULog files written field by field, for topics and firmware versions of which no small log is at hand.

Format: https://docs.px4.io/main/en/dev_log/ulog_file_format.html
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_TYPES = {"u8": "uint64_t", "f4": "float", "i4": "int32_t", "u1": "uint8_t", "f8": "double", "i8": "int64_t"}


class Topic(NamedTuple):
    """One instance of a topic. fields: name to (n,) or (n, k); the first must be the timestamp, us."""

    name: str
    fields: Mapping[str, NDArray[Any]]
    instance: int = 0


def ulog_file(topics: Sequence[Topic], parameters: Mapping[str, float] | None = None) -> bytes:
    """A ULog with the messages of all topics in the order of their time."""
    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    data += _message("B", bytes(40))
    for topic in {topic.name: topic for topic in topics}.values():
        data += _message("F", f"{topic.name}:{_format(topic)}".encode())
    for name, value in (parameters or {}).items():
        kind, packed = ("int32_t", struct.pack("<i", value)) if isinstance(value, int) else (
            "float", struct.pack("<f", value))  # fmt: skip
        key = f"{kind} {name}".encode()
        data += _message("P", bytes([len(key)]) + key + packed)
    rows: list[tuple[int, bytes]] = []
    for number, topic in enumerate(topics):
        data += _message("A", struct.pack("<BH", topic.instance, number) + topic.name.encode())
        rows += _rows(number, topic)
    return data + b"".join(row for _, row in sorted(rows, key=lambda pair: pair[0]))


def _message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def _format(topic: Topic) -> str:
    parts = []
    for name, values in topic.fields.items():
        kind = _TYPES[values.dtype.str[1:]]
        parts.append(f"{kind}[{values.shape[1]}] {name};" if values.ndim > 1 else f"{kind} {name};")
    return "".join(parts)


def _rows(number: int, topic: Topic) -> list[tuple[int, bytes]]:
    kinds = [(name, values.dtype.str, values.shape[1:]) for name, values in topic.fields.items()]
    stamps = next(iter(topic.fields.values()))
    table = np.zeros(len(stamps), dtype=np.dtype(kinds))
    for name, values in topic.fields.items():
        table[name] = values
    prefix = struct.pack("<H", number)
    size = table.dtype.itemsize
    raw = table.tobytes()
    return [
        (int(stamp), _message("D", prefix + raw[i * size : (i + 1) * size])) for i, stamp in enumerate(stamps)
    ]  # fmt: skip
