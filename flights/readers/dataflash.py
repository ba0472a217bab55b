"""ArduPilot DataFlash logs (.bin), read around damage: NED and FRD become ENU and FLU."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from flights.assembly import Assembly
from flights.log import LogContent
from flights.readers.dataflash_messages import Messages, read_messages
from flights.readers.dataflash_rotors import MESSAGES, add_rotors
from flights.source import Source

# the message with which every log begins: FMT (128), which describes itself as 89 bytes long
_MAGIC = b"\xa3\x95\x80\x80\x59FMT\0"
_LATEST_STAMP = 4_102_444_800_000_000  # microseconds: the year 2100, for clocks that count from 1970

# Message to its fields; instances other than the first are left out where the message has an instance field.
_FIELDS: Mapping[str, tuple[str, ...]] = {
    "XKF1": ("PN", "PE", "PD", "VN", "VE", "VD"),
    "NKF1": ("PN", "PE", "PD", "VN", "VE", "VD"),
    "XKQ": ("Q1", "Q2", "Q3", "Q4"),
    "NKQ": ("Q1", "Q2", "Q3", "Q4"),
    "ATT": ("Roll", "Pitch", "Yaw"),
    "IMU": ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "RATE": ("RDes", "PDes", "YDes"),
    "BAT": ("Volt", "Curr"),
    "CURR": ("Volt", "Curr"),
    "ARM": ("ArmState",),
}
_FMT_AS_TEXT = re.compile(rb"^FMT, ?\d+, ?\d+, ?[A-Z0-9]{1,4}, ?[A-Za-z]+, ?[^\r\n]+$", re.MULTILINE)
_INSTANCES = ("C", "I", "Instance", "Inst")


def matches(source: Source) -> bool:
    """Whether it begins with a FMT message."""
    return source.head.startswith(_MAGIC)


def is_text(source: Source) -> bool:
    """Whether it is such a log that a ground station has written as text (.log)."""
    return _FMT_AS_TEXT.search(source.head) is not None


def read(source: Source) -> LogContent:
    """The streams of a DataFlash log; damaged messages are skipped and counted."""
    assembly = Assembly()
    content = read_messages(source.file, {*_FIELDS, *MESSAGES, "PARM", "ESC", "ACC"})
    for name, value in _parameters(content.messages.get("PARM")):
        assembly.parameters[name] = value
    timed = {kind: _timed(kind, rows, assembly) for kind, rows in content.messages.items() if kind != "PARM"}
    dropped = sum(len(content.messages[kind].rows) - len(rows.rows) for kind, rows in timed.items() if rows is not None)
    if content.damaged:
        places = f"{content.damaged} place{'s' * (content.damaged > 1)}"
        assembly.repair("damaged_messages", f"damaged at {places}: {content.skipped} bytes skipped")
    if dropped:
        assembly.repair("damaged_messages", f"{dropped} message{'s' * (dropped > 1)} with an impossible time skipped")
    if content.torn:
        assembly.repair("torn_end", "the log ends within a message; read up to there")
    speeds = timed.pop("ESC", None)
    collected = {kind: _first_instance(rows) for kind, rows in timed.items() if rows is not None}
    collected = {kind: rows for kind, rows in collected.items() if len(rows.rows)}
    _add_streams(assembly, collected)
    add_rotors(assembly, collected, {} if speeds is None else _by_esc(speeds))
    return assembly.finish()


def _parameters(rows: Messages | None) -> Iterator[tuple[str, float]]:
    if rows is not None and rows.has("Name") and rows.has("Value"):
        pairs = zip(rows.texts("Name"), rows.numbers("Value").tolist(), strict=True)
        yield from ((name, value) for name, value in pairs if math.isfinite(value))


def _timed(kind: str, rows: Messages, assembly: Assembly) -> Messages | None:
    """The messages with a time that a log can have; None where this kind has no time."""
    if not rows.has("TimeUS"):
        assembly.note(f"{kind} has no TimeUS, as of ArduPilot before 2015, and is left out")
        return None
    stamps = rows.integers("TimeUS")
    return rows.of((stamps >= 0) & (stamps < _LATEST_STAMP))


def _first_instance(rows: Messages) -> Messages:
    """The messages of a sensor's first instance that was logged."""
    for name in _INSTANCES:
        if rows.has(name):
            instances = rows.integers(name)
            numbers = _usual(instances)
            rows = rows.of(instances == numbers[0]) if len(numbers) else rows
    return rows


def _usual(instances: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of the instances that were logged, in order: a damaged number is a rare one."""
    numbers, counts = np.unique(instances, return_counts=True)
    return np.asarray(numbers[2 * counts >= counts.max(initial=0)])


def _table(rows: Messages, kind: str) -> Floats:
    """(n, k) the fields of a kind, NaN where the messages lack one."""
    return np.stack([rows.numbers(field) for field in _FIELDS[kind]], axis=1)


def _by_esc(rows: Messages) -> dict[int, Messages]:
    if not rows.has("Instance"):
        return {}
    instances = rows.integers("Instance")
    return {int(number): rows.of(instances == number) for number in _usual(instances)}


def _add_streams(assembly: Assembly, collected: Mapping[str, Messages]) -> None:
    def rows(*kinds: str) -> tuple[Floats, Floats, str] | None:
        kind = next((kind for kind in kinds if kind in collected), None)
        if kind is None:
            return None
        return assembly.seconds(collected[kind].integers("TimeUS"), 1_000_000), _table(collected[kind], kind), kind

    if samples := rows("XKF1", "NKF1"):
        time, table, kind = samples
        assembly.add("position", time, frames.enu_from_ned(table[:, :3]), kind)
        assembly.add("velocity", time, frames.enu_from_ned(table[:, 3:]), kind)
    if samples := rows("XKQ", "NKQ"):
        time, table, kind = samples
        assembly.add("attitude", time, frames.attitude_enu_flu(table), kind)
    if samples := rows("ATT"):
        time, table, kind = samples
        angles = np.radians(table)
        attitude = frames.attitude_enu_flu(quaternion.from_euler(angles[:, 0], angles[:, 1], angles[:, 2]))
        assembly.add("attitude", time, attitude, kind)
    if samples := rows("IMU"):
        time, table, kind = samples
        assembly.add("rate", time, frames.flu_from_frd(table[:, :3]), kind)
        assembly.add("specific_force", time, frames.flu_from_frd(table[:, 3:]), kind)
    elif (raw := collected.get("ACC")) is not None and raw.has("AccX"):
        force = np.stack([raw.numbers(f"Acc{axis}") for axis in "XYZ"], axis=1)
        reason = "they are one sensor's before filters and calibration; log IMU"
        assembly.leave_out("specific_force", "ACC", ["AccX", "AccY", "AccZ"], force, reason)
    if samples := rows("RATE"):
        time, table, kind = samples
        assembly.add("rate_setpoint", time, frames.flu_from_frd(np.radians(table)), kind)
    if samples := rows("BAT", "CURR"):
        time, table, kind = samples
        assembly.add("battery_voltage", time, table[:, 0], kind)
        assembly.add("battery_current", time, table[:, 1], kind)
    if samples := rows("ARM"):
        time, table, kind = samples
        assembly.add("armed", time, table[:, 0] != 0, kind)
