"""Messages of ArduPilot's binary logs, read around damage.

A message is A3 95, its type, and a body whose length and fields an earlier FMT message states. There is no checksum: it
counts as whole when its type is known and another message, or the file's end, follows it. Bytes between whole messages
are skipped and counted. Source: ArduPilot, AP_Logger/LogStructure.h.
"""

from __future__ import annotations

import mmap
from array import array
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Floats

SYNC = b"\xa3\x95"
HEADER_BYTES = 3
FORMAT = 128  # type of FMT
_FORMAT_BYTES = 89
_FORMAT_BODY = np.dtype(
    [("type", "u1"), ("length", "u1"), ("name", "S4"), ("format", "S16"), ("columns", "S64")]
)  # BBnNZ
# character of a format to numpy's type and the factor to the field's unit
_FIELD_TYPES: Mapping[str, tuple[str, float]] = {
    "a": ("S64", 1.0), "b": ("i1", 1.0), "B": ("u1", 1.0), "g": ("<f2", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0),
    "i": ("<i4", 1.0), "I": ("<u4", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0), "n": ("S4", 1.0), "N": ("S16", 1.0),
    "Z": ("S64", 1.0), "c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01),
    "L": ("<i4", 1e-7), "M": ("u1", 1.0), "q": ("<i8", 1.0), "Q": ("<u8", 1.0),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Messages:
    """The messages of one name. n: messages.

    rows: (n,) the fields as logged.
    factors: to a field's unit, for those that are logged in hundredths or so.
    """

    rows: NDArray[np.void]
    factors: Mapping[str, float]

    def has(self, field: str) -> bool:
        """Whether the messages have a field."""
        return field in self.factors

    def integers(self, field: str) -> NDArray[np.int64]:
        """(n,) a field without rounding; above 2^63 it becomes negative."""
        return self.rows[field].astype(np.int64)

    def texts(self, field: str) -> list[str]:
        """(n,) a field of characters."""
        return [text.decode("ascii", "replace") for text in self.rows[field].tolist()]

    def numbers(self, field: str) -> Floats:
        """(n,) a field in its unit; NaN where the messages lack it."""
        if not self.has(field):
            return np.full(len(self.rows), np.nan)
        return self.rows[field].astype(float) * self.factors[field]

    def of(self, selected: NDArray[np.bool_]) -> Messages:
        """Some of the messages. selected: (n,)."""
        return Messages(self.rows[selected], self.factors)


@dataclass(frozen=True, eq=False)
class Content:
    """The messages of a log by name, and what of it is lost.

    damaged: places between messages where bytes are no message.
    skipped: bytes there.
    torn: whether the log ends within a message.
    """

    messages: Mapping[str, Messages]
    damaged: int
    skipped: int
    torn: bool


@dataclass(frozen=True)
class _Format:
    name: str
    length: int
    body: np.dtype[np.void]
    factors: Mapping[str, float]


@dataclass
class _Index:
    """Formats and places of messages by type, and what of the log is lost as in `Content`."""

    formats: dict[int, _Format] = field(default_factory=dict)
    places: dict[int, array[int]] = field(default_factory=lambda: {number: array("q") for number in range(256)})
    damaged: int = 0
    skipped: int = 0
    torn: bool = False


def read_messages(file: Path, names: Collection[str]) -> Content:
    """The messages of some names of a log, in the order in which they were written."""
    with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        index = _index(data)
        messages: dict[str, Messages] = {}
        for number, form in index.formats.items():
            if form.name in names and index.places[number]:
                offsets = np.array(index.places[number], dtype=np.int64)
                messages[form.name] = Messages(_rows(data, offsets, form), form.factors)
    return Content(messages, index.damaged, index.skipped, index.torn)


def _index(data: mmap.mmap) -> _Index:
    lengths = [0] * 256
    lengths[FORMAT] = _FORMAT_BYTES
    index = _Index()
    position, size = 0, len(data)
    while position + HEADER_BYTES <= size:
        number = data[position + 2]
        end = position + lengths[number]
        is_whole = data[position : position + 2] == SYNC and lengths[number] and end <= size
        if not is_whole or data[end : end + 2] not in (SYNC, SYNC[: size - end]):
            following = _next_whole(data, position + 1, lengths)
            if following is not None:
                index.damaged += 1
                index.skipped += following - position
                position = following
                continue
            if not is_whole:
                break
        if number == FORMAT and (stated := _format(data, position)) is not None:
            form = index.formats.setdefault(*stated)
            lengths[stated[0]] = form.length
        index.places[number].append(position)
        position = end
    index.torn = _is_torn(data[position:])
    return index


def _next_whole(data: mmap.mmap, start: int, lengths: list[int]) -> int | None:
    """The place of the next message of a known type behind which another message or the file's end comes."""
    position = data.find(SYNC, start)
    while position >= 0 and position + HEADER_BYTES <= len(data):
        length = lengths[data[position + 2]]
        end = position + length
        if length and (data[end : end + 2] == SYNC or end == len(data)):
            return position
        position = data.find(SYNC, position + 1)
    return None


def _is_torn(rest: bytes) -> bool:
    """Whether bytes behind the last message are more than the padding of a page."""
    return bool(rest.strip(b"\0\xff"))


def _format(data: mmap.mmap, position: int) -> tuple[int, _Format] | None:
    """Type and format that a FMT message states; None where its parts contradict each other, as damaged ones do."""
    body = np.frombuffer(data[position + HEADER_BYTES : position + _FORMAT_BYTES], dtype=_FORMAT_BODY)[0]
    try:
        name, form, columns = (body[key].split(b"\0")[0].decode("ascii") for key in ("name", "format", "columns"))
        fields = [(column, *_FIELD_TYPES[letter]) for column, letter in zip(columns.split(","), form, strict=True)]
        dtype = np.dtype([(column, kind) for column, kind, _ in fields])
    except (UnicodeDecodeError, KeyError, ValueError):
        return None
    length = int(body["length"])
    if dtype.itemsize + HEADER_BYTES != length:
        return None
    return int(body["type"]), _Format(name, length, dtype, {column: factor for column, _, factor in fields})


def _rows(data: mmap.mmap, offsets: NDArray[np.int64], form: _Format) -> NDArray[np.void]:
    """(n,) the bodies of messages. offsets: (n,) where they begin."""
    view = np.frombuffer(data, dtype=np.uint8)
    size = form.body.itemsize
    table = np.empty((len(offsets), size), dtype=np.uint8)
    for start in range(0, len(offsets), 65_536):  # an index of every byte at once would be eight times the log
        part = offsets[start : start + 65_536]
        table[start : start + len(part)] = view[part[:, None] + HEADER_BYTES + np.arange(size)]
    return table.view(form.body)[:, 0]
