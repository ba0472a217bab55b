"""The MAVLink messages of the mock: pymavlink's `common` dialect and three that its wheels leave out.

ESC_INFO (290), ESC_STATUS (291) and PROTOCOL_VERSION (300) are marked as work in progress in MAVLink's common.xml, so
that pymavlink's generated modules lack them although PX4 sends them; rotor speeds travel in nothing else.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from typing import Any

os.environ.setdefault("MAVLINK20", "1")

from pymavlink.dialects.v20 import common as mavlink

__all__ = ["AUTOPILOT_COMPONENT", "EscInfo", "EscStatus", "Message", "ProtocolVersion", "mavlink"]

Message = Any  # pymavlink carries no types that a checker could use

AUTOPILOT_COMPONENT = 1
ROTORS_PER_MESSAGE = 4


class EscStatus(mavlink.MAVLink_message):  # type: ignore[misc]
    """ESC_STATUS: rotor speeds (revolutions per minute), voltages (V) and currents (A) of up to four rotors."""

    id = 291
    msgname = "ESC_STATUS"
    fieldnames = ("index", "time_usec", "rpm", "voltage", "current")
    crc_extra = 10
    unpacker = struct.Struct("<Q4i4f4fB")

    def __init__(
        self, index: int, time_usec: int, rpm: Sequence[int], voltage: Sequence[float], current: Sequence[float]
    ):
        mavlink.MAVLink_message.__init__(self, self.id, self.msgname)
        self._fieldnames = list(self.fieldnames)
        self.index = index
        self.time_usec = time_usec
        self.rpm = _four(rpm)
        self.voltage = _four(voltage)
        self.current = _four(current)

    def pack(self, mav: Message, force_mavlink1: bool = False) -> bytes:
        """The frame's bytes, fields in MAVLink's wire order (largest type first)."""
        payload = self.unpacker.pack(self.time_usec, *self.rpm, *self.voltage, *self.current, self.index)
        return bytes(self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1))


class EscInfo(mavlink.MAVLink_message):  # type: ignore[misc]
    """ESC_INFO: which of up to four speed controllers are online."""

    id = 290
    msgname = "ESC_INFO"
    fieldnames = ("index", "time_usec", "counter", "count", "connection_type", "info")
    crc_extra = 251
    unpacker = struct.Struct("<Q4IH4H4hBBBB")

    def __init__(self, index: int, time_usec: int, counter: int, count: int):
        mavlink.MAVLink_message.__init__(self, self.id, self.msgname)
        self._fieldnames = list(self.fieldnames)
        self.index = index
        self.time_usec = time_usec
        self.counter = counter
        self.count = count
        self.connection_type = 0
        self.info = (1 << min(max(count - index, 0), ROTORS_PER_MESSAGE)) - 1

    def pack(self, mav: Message, force_mavlink1: bool = False) -> bytes:
        """The frame's bytes, fields in MAVLink's wire order (largest type first)."""
        healthy = [0] * (3 * ROTORS_PER_MESSAGE)
        payload = self.unpacker.pack(
            self.time_usec,
            *healthy[:4],
            self.counter,
            *healthy[4:],
            self.index,
            self.count,
            self.connection_type,
            self.info,
        )
        return bytes(self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1))


class ProtocolVersion(mavlink.MAVLink_message):  # type: ignore[misc]
    """PROTOCOL_VERSION: MAVLink 2, and version 1 is understood."""

    id = 300
    msgname = "PROTOCOL_VERSION"
    fieldnames = ("version", "min_version", "max_version")
    crc_extra = 217
    unpacker = struct.Struct("<HHH16x")

    def __init__(self) -> None:
        mavlink.MAVLink_message.__init__(self, self.id, self.msgname)
        self._fieldnames = list(self.fieldnames)
        self.version, self.min_version, self.max_version = 200, 100, 200

    def pack(self, mav: Message, force_mavlink1: bool = False) -> bytes:
        """The frame's bytes."""
        payload = self.unpacker.pack(self.version, self.min_version, self.max_version)
        return bytes(self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1))


def _four(values: Sequence[Any]) -> list[Any]:
    return [*values[:ROTORS_PER_MESSAGE], *[0] * (ROTORS_PER_MESSAGE - len(values))]
