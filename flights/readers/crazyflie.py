"""Crazyflie micro-SD card logs, versions 1 and 2 (Bitcraze's usdlog; little endian).

0xBC, u16 version, u16 number of event types; each type: u16 id, name, u16 number of variables, each "group.name(c)"
with its struct letter, all texts zero-terminated; then records of u16 id, time (version 1: u32 ms, 2: u64 us) and the
packed values; a CRC-32 of all that at the end.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynamics import quaternion
from dynamics.arrays import Floats
from dynamics.errors import DataError
from dynamics.frames import quaternion_from_xyzw
from dynamics.units import RPM
from dynamics.vehicle import GRAVITY
from flights.assembly import Assembly
from flights.log import LogContent
from flights.readers.unused_variables import keep_variables
from flights.source import Source, TimeSpan

_MAGIC = 0xBC
_CLOCKS = {1: ("<u4", 1_000), 2: ("<u8", 1_000_000)}
_LETTERS = frozenset("bBhHiIqQefd?")
_CRC_BYTES = 4
_FIRST_RUN, _MAX_RUN = 64, 1 << 20  # records of one type that are decoded together
_FULL_COMMAND = 65_535.0
_DEGREE = np.pi / 180
# Crazyflie's motors 1 front right, 2 back right, 3 back left, 4 front left in our order
_ROTORS = ("m4", "m3", "m2", "m1")


@dataclass(frozen=True)
class EventType:
    """One type of record.

    number: its id.
    dtype: of a whole record, id and time included.
    variables: group.name of its values.
    """

    number: int
    name: str
    dtype: np.dtype[np.void]
    variables: tuple[str, ...]


@dataclass(frozen=True)
class Header:
    """The header of a log.

    types: by id.
    size: bytes before the first record.
    ticks: of the clock, a second.
    """

    version: int
    types: Mapping[int, EventType]
    size: int
    ticks: int


def matches(source: Source) -> bool:
    """Whether it has the magic byte, a plausible version and a readable list of event types."""
    if source.head[:1] != bytes([_MAGIC]):
        return False
    try:
        parse_header(source.head)
    except DataError:
        return len(source.head) > 3 and source.head[2] == 0 and source.head[4:5] == b"\0"
    return True


def read(source: Source) -> LogContent:
    """The streams of a micro-SD log. Raises DataError for an unknown version or a damaged header."""
    assembly = Assembly()
    header = parse_header(source.head)
    with source.file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        place = None if source.span is None else source.span.place
        start, end = place or (header.size, _end_of_records(data, header, assembly))
        tables, position = _records(data, header, start, end, source.span)
    if position is not None and position < end:
        assembly.repair("torn_record", f"{end - position} bytes at the end that are no whole record dropped")
    assembly.metadata["version"] = str(header.version)
    table = tables.get(_main_type(header, tables))
    if table is None or not len(table):
        if source.span is not None:
            return assembly.finish()
        raise DataError("this Crazyflie log has a header but no records.")
    _add_streams(assembly, table, header.ticks)
    for number, kind in header.types.items():
        if kind is not header.types[_main_type(header, tables)] and len(tables.get(number, ())):
            assembly.note(f"{len(tables[number])} events {kind.name!r} are left out")
            columns = {f"{kind.name}.{name}": tables[number][f"v:{name}"].astype(float) for name in kind.variables}
            keep_variables(assembly, columns, (), ())
    if source.span is None:  # a span of it would choose otherwise than the next one
        assembly.settle_rivals()
    return assembly.finish()


def parse_header(head: bytes) -> Header:
    """The header of a log. Raises DataError when it is damaged or of an unknown version."""
    try:
        magic, version, count = struct.unpack_from("<BHH", head)
        if magic != _MAGIC:
            raise DataError("this is no Crazyflie micro-SD log: its first byte is not 0xBC.")
        if version not in _CLOCKS:
            raise DataError(f"this Crazyflie log has format version {version}; versions 1 and 2 are read.")
        clock, ticks = _CLOCKS[version]
        position, types = 5, {}
        for _ in range(count):
            kind, position = _parse_type(head, position, clock)
            types[kind.number] = kind
    except (struct.error, ValueError) as error:
        raise DataError(f"the header of this Crazyflie log is damaged or cut off ({error}).") from None
    if not types:
        raise DataError("this Crazyflie log names no event types, so that it holds nothing.")
    return Header(version, types, position, ticks)


def _parse_type(head: bytes, position: int, clock: str) -> tuple[EventType, int]:
    (number,) = struct.unpack_from("<H", head, position)
    name, position = _text(head, position + 2)
    (count,) = struct.unpack_from("<H", head, position)
    position += 2
    fields: list[tuple[str, str]] = [("id", "<u2"), ("time", clock)]
    variables: list[str] = []
    for _ in range(count):
        text, position = _text(head, position)
        variable, letter = text[:-3], text[-2:-1]
        if text[-3:] != f"({letter})" or letter not in _LETTERS or variable in variables:
            raise ValueError(f"variable {text!r}")
        variables.append(variable)
        fields.append((f"v:{variable}", np.dtype(letter).newbyteorder("<").str))
    return EventType(number, name, np.dtype(fields), tuple(variables)), position


def _text(head: bytes, position: int) -> tuple[str, int]:
    end = head.index(b"\0", position)
    return head[position:end].decode("ascii"), end + 1


def _end_of_records(data: mmap.mmap, header: Header, assembly: Assembly) -> int:
    """Where the records end: before a correct checksum, or else at the end of the file, which becomes a repair."""
    size = len(data)
    if size < header.size + _CRC_BYTES:
        return size
    crc = 0
    for start in range(0, size - _CRC_BYTES, _MAX_RUN):
        crc = zlib.crc32(data[start : min(start + _MAX_RUN, size - _CRC_BYTES)], crc)
    if crc == int.from_bytes(data[-_CRC_BYTES:], "little"):
        return size - _CRC_BYTES
    assembly.repair("checksum_failed", "the CRC-32 at the end does not hold: the log was cut off or changed")
    return size


def _records(
    data: mmap.mmap, header: Header, start: int, end: int, span: TimeSpan | None
) -> tuple[dict[int, NDArray[np.void]], int | None]:
    """Records by type, and where reading ended, None where the span ended it. An unknown id ends it as well."""
    runs: dict[int, list[NDArray[np.void]]] = {}
    position, run = start, _FIRST_RUN
    while position + 2 <= end:
        kind = header.types.get(int.from_bytes(data[position : position + 2], "little"))
        if kind is None:
            break
        size = kind.dtype.itemsize
        count = min((end - position) // size, run)
        if count == 0:
            break
        records = np.frombuffer(data[position : position + count * size], dtype=kind.dtype)
        other = np.flatnonzero(records["id"] != kind.number)
        same_kind = int(other[0]) if len(other) else count
        rows = records[:same_kind]
        if span is not None:
            span.origin = float(rows["time"][0]) if span.origin is None else span.origin
            elapsed = (rows["time"].astype(np.int64) - int(span.origin)) / header.ticks
            if not span.more:
                span.place = (position + size * int(np.count_nonzero(np.cumsum(elapsed >= span.end) == 0)), end)
            rows = rows[span.mask(elapsed)]
            if span.is_past(float(elapsed.min())):
                return _joined_runs(runs), None
        runs.setdefault(kind.number, []).append(rows)
        position += same_kind * size
        run = min(2 * run, _MAX_RUN) if same_kind == count else _FIRST_RUN
    return _joined_runs(runs), position


def _joined_runs(runs_by_type: Mapping[int, list[NDArray[np.void]]]) -> dict[int, NDArray[np.void]]:
    return {number: np.concatenate(runs) for number, runs in runs_by_type.items()}


def _main_type(header: Header, tables: Mapping[int, NDArray[np.void]]) -> int:
    """The type with the most numbers in the file."""
    return max(header.types, key=lambda number: tables[number].nbytes if number in tables else 0)


def _add_streams(assembly: Assembly, table: NDArray[np.void], ticks: int) -> None:
    names = [name.removeprefix("v:") for name in (table.dtype.names or ())[2:]]
    columns = {name: table[f"v:{name}"].astype(float) for name in names}
    used = add_variables(assembly, assembly.seconds(table["time"], ticks), columns)
    unused = [name for name in names if name not in used]
    if unused:
        assembly.note(f"variables that are none of a flight's quantities: {', '.join(unused)}")


def add_variables(assembly: Assembly, time: Floats, columns: Mapping[str, Floats]) -> set[str]:
    """Add the streams of log variables, (n,) each by its group.name; returns the names of those that were used.

    Those that may be a quantity and are not used are kept as unused.
    """
    used: set[str] = set()
    for name, variables, convert in STREAMS:
        if all(variable in columns for variable in variables):
            values = np.stack([columns[variable] for variable in variables], axis=1)
            assembly.add(name, time, convert(values), variables[0].rpartition(".")[0] + "." + _joined(variables))
            used.update(variables)
    keep_variables(assembly, columns, used, [(name, variables) for name, variables, _ in STREAMS])
    return used


def _joined(variables: tuple[str, ...]) -> str:
    return "/".join(variable.rpartition(".")[2] for variable in variables)


def _scaled(factor: float) -> Callable[[Floats], Floats]:
    return lambda values: values * factor


def _from_euler(values: Floats) -> Floats:
    return quaternion.from_euler(values[:, 0], values[:, 1], values[:, 2])


def _from_legacy_euler(values: Floats) -> Floats:
    """Attitude of `stateEstimate`'s degrees, whose pitch has the sign of the Crazyflie 1's: nose up is negative."""
    return _from_euler(values * _DEGREE * np.array([1.0, -1.0, 1.0]))


def _from_legacy_rates(values: Floats) -> Floats:
    """Body rates of `stateEstimateZ`'s mrad/s, which the firmware gives the old sign of pitch as well."""
    return np.asarray(values * 1e-3 * np.array([1.0, -1.0, 1.0]))


def _from_compressed(values: Floats) -> Floats:
    """Attitude of Bitcraze's quatcompress: two bits name the largest component, ten bits hold each other one."""
    words = values[:, 0].astype(np.uint32)
    largest = (words >> 30).astype(int)
    xyzw = np.zeros((len(words), 4))
    for index in range(3, -1, -1):
        held = largest != index
        size = (words & 511) / 511 * np.sqrt(0.5)
        xyzw[:, index] = np.where(held, np.where((words >> 9) & 1, -size, size), 0.0)
        words = np.where(held, words >> 10, words)
    rest = np.sqrt(np.maximum(0.0, 1.0 - np.sum(xyzw**2, axis=1)))
    xyzw[np.arange(len(xyzw)), largest] = rest
    return quaternion_from_xyzw(xyzw)


def _group(group: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{group}.{name}" for name in names)


_MILLI = 1e-3
# Quantity, variables in the order of its columns, conversion; of several for one quantity the first is used.
# stateEstimateZ's acceleration is left out: firmwares differ in whether gravity is in it.
STREAMS: tuple[tuple[str, tuple[str, ...], Callable[[Floats], Floats]], ...] = (
    ("position", _group("stateEstimate", "x", "y", "z"), _scaled(1.0)),
    ("position", _group("stateEstimateZ", "x", "y", "z"), _scaled(_MILLI)),
    ("position", _group("kalman", "stateX", "stateY", "stateZ"), _scaled(1.0)),
    ("velocity", _group("stateEstimate", "vx", "vy", "vz"), _scaled(1.0)),
    ("velocity", _group("stateEstimateZ", "vx", "vy", "vz"), _scaled(_MILLI)),
    ("attitude", _group("stateEstimate", "qx", "qy", "qz", "qw"), quaternion_from_xyzw),
    ("attitude", ("stateEstimateZ.quat",), _from_compressed),
    ("attitude", _group("stateEstimate", "roll", "pitch", "yaw"), _from_legacy_euler),
    ("attitude", _group("stabilizer", "roll", "pitch", "yaw"), _from_legacy_euler),  # stateEstimate's angles
    ("attitude", _group("ctrlLee", "rpyx", "rpyy", "rpyz"), _from_euler),
    ("rate", _group("gyro", "x", "y", "z"), _scaled(_DEGREE)),
    ("rate", _group("stateEstimateZ", "rateRoll", "ratePitch", "rateYaw"), _from_legacy_rates),
    ("rate", _group("ctrlLee", "omegax", "omegay", "omegaz"), _scaled(1.0)),
    ("specific_force", _group("acc", "x", "y", "z"), _scaled(GRAVITY)),
    ("acceleration", _group("stateEstimate", "ax", "ay", "az"), _scaled(GRAVITY)),
    ("roll", ("stateEstimate.roll",), _scaled(_DEGREE)),
    ("pitch", ("stateEstimate.pitch",), _scaled(-_DEGREE)),
    ("yaw", ("stateEstimate.yaw",), _scaled(_DEGREE)),
    ("rotor_speed", _group("rpm", *_ROTORS), _scaled(RPM)),
    ("rotor_command", _group("motor", *_ROTORS), _scaled(1 / _FULL_COMMAND)),
    ("rotor_command", tuple(f"pwm.{rotor}_pwm" for rotor in _ROTORS), _scaled(1 / _FULL_COMMAND)),
    ("battery_voltage", ("pm.vbat",), _scaled(1.0)),
    ("battery_voltage", ("pm.vbatMV",), _scaled(_MILLI)),
    ("position_setpoint", _group("ctrltarget", "x", "y", "z"), _scaled(1.0)),
    ("position_setpoint", _group("ctrltargetZ", "x", "y", "z"), _scaled(_MILLI)),
    ("velocity_setpoint", _group("ctrltarget", "vx", "vy", "vz"), _scaled(1.0)),
    ("velocity_setpoint", _group("ctrltargetZ", "vx", "vy", "vz"), _scaled(_MILLI)),
    ("attitude_setpoint", _group("ctrlLee", "rpydx", "rpydy", "rpydz"), _from_euler),
    ("rate_setpoint", _group("ctrlLee", "omegarx", "omegary", "omegarz"), _scaled(1.0)),
    ("collective_thrust_command", ("ctrlLee.thrustSi",), _scaled(1.0)),
    ("torque_command", _group("ctrlLee", "torquex", "torquey", "torquez"), _scaled(1.0)),
)
VARIABLES = frozenset(variable for _, variables, _ in STREAMS for variable in variables)  # that are read
