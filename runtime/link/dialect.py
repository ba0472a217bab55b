"""The MAVLink dialect: pymavlink's messages, and those that PX4 sends and pymavlink lacks.

pymavlink is generated from ArduPilot's definitions; the messages added here are from MAVLink's common.xml. This is the
only file that accesses pymavlink's tables. Where pymavlink is not installed they are those of the module that setup.py
takes out of it into a wheel.
"""

from __future__ import annotations

import importlib
import struct
from importlib import util
from typing import Any

import msgspec

mavlink: Any = importlib.import_module(
    "pymavlink.dialects.v20.development" if util.find_spec("pymavlink") else "runtime.link.mavlink_messages"
)
x25crc = mavlink.x25crc

__all__ = ["MESSAGE_IDS", "Definition", "Field", "Message", "mavlink", "message_class", "x25crc"]

Message = Any  # an instance of one of pymavlink's generated classes, whose fields have no common type

_FORMATS = {
    "uint64_t": "Q", "float": "f", "uint32_t": "I", "int32_t": "i", "uint16_t": "H", "int16_t": "h", "uint8_t": "B",
}  # fmt: skip


class Field(msgspec.Struct, frozen=True):
    """One field of a message: its C type, name, and number of elements, 0 for a scalar."""

    type: str
    name: str
    length: int = 0

    @property
    def size(self) -> int:
        """Size of one element in bytes, by which fields are ordered on the wire."""
        return struct.calcsize(_FORMATS[self.type])


class Definition(msgspec.Struct, frozen=True):
    """A message of MAVLink's common.xml, its fields in the order of the XML."""

    id: int
    name: str
    fields: tuple[Field, ...]


_MISSING = (
    Definition(8, "LINK_NODE_STATUS", (
        Field("uint64_t", "timestamp"), Field("uint8_t", "tx_buf"), Field("uint8_t", "rx_buf"),
        Field("uint32_t", "tx_rate"), Field("uint32_t", "rx_rate"), Field("uint16_t", "rx_parse_err"),
        Field("uint16_t", "tx_overflows"), Field("uint16_t", "rx_overflows"), Field("uint32_t", "messages_sent"),
        Field("uint32_t", "messages_received"), Field("uint32_t", "messages_lost"),
    )),
    Definition(290, "ESC_INFO", (
        Field("uint8_t", "index"), Field("uint64_t", "time_usec"), Field("uint16_t", "counter"),
        Field("uint8_t", "count"), Field("uint8_t", "connection_type"), Field("uint8_t", "info"),
        Field("uint16_t", "failure_flags", 4), Field("uint32_t", "error_count", 4), Field("int16_t", "temperature", 4),
    )),
    Definition(291, "ESC_STATUS", (
        Field("uint8_t", "index"), Field("uint64_t", "time_usec"), Field("int32_t", "rpm", 4),
        Field("float", "voltage", 4), Field("float", "current", 4),
    )),
    Definition(380, "TIME_ESTIMATE_TO_TARGET", (
        Field("int32_t", "safe_return"), Field("int32_t", "land"), Field("int32_t", "mission_next_item"),
        Field("int32_t", "mission_end"), Field("int32_t", "commanded_action"),
    )),
    Definition(410, "EVENT", (
        Field("uint8_t", "destination_component"), Field("uint8_t", "destination_system"), Field("uint32_t", "id"),
        Field("uint32_t", "event_time_boot_ms"), Field("uint16_t", "sequence"), Field("uint8_t", "log_levels"),
        Field("uint8_t", "arguments", 40),
    )),
    Definition(411, "CURRENT_EVENT_SEQUENCE", (Field("uint16_t", "sequence"), Field("uint8_t", "flags"))),
    Definition(436, "CURRENT_MODE", (
        Field("uint8_t", "standard_mode"), Field("uint32_t", "custom_mode"),
        Field("uint32_t", "intended_custom_mode"),
    )),
)  # fmt: skip


def message_class(definition: Definition) -> type:
    """A class for pymavlink's decoder and packer from a definition, as its generator would write it."""
    fields = definition.fields
    wire = sorted(fields, key=lambda field: -field.size)  # MAVLink reorders by element size, stably
    unpacker = struct.Struct("<" + "".join(f"{field.length or ''}{_FORMATS[field.type]}" for field in wire))
    names = [field.name for field in fields]

    def initialise(self: Message, *values: object, **named: object) -> None:
        mavlink.MAVLink_message.__init__(self, definition.id, definition.name)
        self._fieldnames = names
        for name, value in {**dict(zip(names, values, strict=False)), **named}.items():
            setattr(self, name, value)

    def pack(self: Message, mav: Message, force_mavlink1: bool = False) -> bytes:
        values: list[Any] = []
        for field in wire:
            value = getattr(self, field.name)
            values += list(value) if field.length else [value]
        return bytes(self._pack(mav, _crc_extra(definition.name, wire), unpacker.pack(*values), force_mavlink1))

    contents = {
        "id": definition.id,
        "msgname": definition.name,
        "fieldnames": names,
        "ordered_fieldnames": [field.name for field in wire],
        "orders": [wire.index(field) for field in fields],
        "lengths": [field.length or 1 for field in wire],
        "array_lengths": [field.length for field in wire],
        "crc_extra": _crc_extra(definition.name, wire),
        "unpacker": unpacker,
        "__init__": initialise,
        "pack": pack,
    }
    return type(f"MAVLink_{definition.name.lower()}_message", (mavlink.MAVLink_message,), contents)


def _crc_extra(name: str, wire: list[Field]) -> int:
    """The byte that ties a checksum to a definition (MAVLink serialisation guide, CRC_EXTRA)."""
    crc = x25crc(f"{name} ".encode())
    for field in wire:
        crc.accumulate(f"{field.type} {field.name} ".encode())
        if field.length:
            crc.accumulate(bytes([field.length]))
    return int(crc.crc & 0xFF) ^ int(crc.crc >> 8)


for _definition in _MISSING:  # a pymavlink that has them keeps its own
    mavlink.mavlink_map.setdefault(_definition.id, message_class(_definition))

MESSAGE_IDS: dict[str, int] = {kind.msgname: number for number, kind in mavlink.mavlink_map.items()}
