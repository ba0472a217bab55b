"""Decoded blackbox logs of Betaflight, INAV and Rotorflight: the CSV of blackbox_decode or of the blackbox explorer.

Betaflight's body is x forward, y left, z up (its mixer answers a positive pitch error with the rear motors), and its
quaternion turns that body to a world with z up; INAV's angles are roll, pitch and heading in tenths of a degree.
Decoders differ in the gyro's signs: those are taken in which it closes with the attitude, or with the motors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynamics import frames, quaternion
from dynamics.arrays import Floats
from dynamics.units import RPM
from dynamics.vehicle import GRAVITY
from flights.assembly import Assembly
from flights.log import LogContent
from flights.readers import csv
from flights.readers.blackbox_fields import (
    ITERATION,
    POLES,
    TIME,
    Fields,
    fields_of,
    gyro_scale,
    median,
    motor_range,
    one_g,
    split_preamble,
)
from flights.readers.mapped_csv import quaternion_of_vector_part
from flights.readers.table_head import lines_of, names_of
from flights.source import Source

OUR_ORDER = (3, 2, 0, 1)  # motors 1 back right, 2 front right, 3 back left, 4 front left as our rotors
_QUATERNION_ONE = 32_767.0
_SPAN = 0.02  # s over which turning is compared
_MIN_TURNING = 0.1  # rad/s rms, below which attitude and gyro cannot be compared
_CLOSES = 0.5  # correlation about zero
_MOTORS_SHOW = 0.15  # of angular acceleration and the motors' difference
_TENTHS = np.pi / 1800
_FLU, _FRD = np.array([1.0, 1.0, 1.0]), np.array([1.0, -1.0, -1.0])
_HIGH_RESOLUTION = (7.0, 14.0)  # gyro over turning of logs in tenths of a degree a second


@dataclass(frozen=True)
class _Table:
    """A decoded blackbox. column: (n,) the numbers of a column by its name in the file."""

    fields: Fields
    time: Floats
    column: Mapping[str, Floats]

    def stack(self, *columns: str) -> Floats:
        """(n, k) columns by their names in the file."""
        return np.stack([self.column[name] for name in columns], axis=1)

    def array(self, field: str) -> Floats:
        """(n, k) an array field, without columns where it is not there."""
        names = [name for name in self.fields.array(field) if name in self.column]
        return self.stack(*names) if names else np.empty((len(self.time), 0))


def matches(source: Source) -> bool:
    """Whether it is a table with the columns that every decoded blackbox has."""
    return ITERATION.encode() in source.head and split_preamble(lines_of(source))[0] >= 0


def read(source: Source) -> LogContent:
    """The streams of a decoded blackbox. Raises DataError for one that cannot be read as a table."""
    return read_decoded(source.file, lines_of(source), {}, Assembly())


def read_decoded(file: Path, lines: Sequence[str], stated: Mapping[str, str], assembly: Assembly) -> LogContent:
    """The streams of a decoded blackbox. lines: its first ones. stated: header of the log that it was decoded from."""
    before, header = split_preamble(lines)
    names = names_of(lines[before])
    fields = fields_of(names, {**header, **stated})
    layout = csv.Layout(names, lines=before + 1)

    def numbers(used: Sequence[str]) -> dict[str, Floats]:
        return csv.read_columns(file, layout, used, assembly)

    primary, secondary = _needed(fields)
    columns = csv.readable_columns(numbers, primary, secondary, assembly)
    unit = fields.factor(TIME) or 1e-6
    ticks = columns[fields.columns[TIME]]
    finite = ticks[np.isfinite(ticks)]
    origin = float(finite[0]) if len(finite) else 0.0
    assembly.origin = origin * unit
    table = _Table(fields, (ticks - origin) * unit, columns)
    assembly.metadata["firmware"] = fields.header.get("Firmware revision", fields.firmware)
    _add_streams(assembly, table)
    return assembly.finish()


def _needed(fields: Fields) -> tuple[list[str], dict[str, list[str]]]:
    """The columns that are read: the time and those that the physics needs, and secondary ones by quantity."""
    arrays = ("gyroADC", "accSmooth", "accADC", "imuQuaternion", "attitude", "motor", "eRPM", "navPos", "navVel")
    primary = [fields.columns[TIME], *(name for array in arrays for name in fields.array(array))]
    secondary = {
        "battery_voltage": [fields.columns[name] for name in ("vbatLatest", "vbat") if fields.has(name)][:1],
        "battery_current": [fields.columns[name] for name in ("amperageLatest", "amperage") if fields.has(name)][:1],
        "rate_setpoint": fields.array("setpoint")[:3] if len(fields.array("setpoint")) >= 3 else [],
    }
    return primary, {name: columns for name, columns in secondary.items() if columns}


def _add_streams(assembly: Assembly, table: _Table) -> None:
    fields, time = table.fields, table.time
    gyro = table.array("gyroADC")
    factor = fields.factor("gyroADC[0]") or gyro_scale(fields)
    rate = gyro * factor if gyro.shape[1] == 3 else None
    motors = table.array("motor")
    attitude = _attitude(table, rate)
    signs = _FLU
    if rate is not None and len(time) > 1:
        signs, reason = _gyro_signs(time, rate, attitude, motors)
        axes = "x forward, y left, z up" if signs is _FLU else "x forward, y right, z down"
        assembly.note(f"{fields.firmware}'s gyro is read as {axes}: {reason}")
        if attitude is not None and fields.factor("gyroADC[0]") is None and _is_in_tenths(time, rate * signs, attitude):
            rate = rate / 10.0
            assembly.note("the gyro is in tenths of a degree a second (blackbox_high_resolution), by its attitude")
    if rate is not None:
        assembly.add("rate", time, rate * signs, "gyroADC")
    _add_force(assembly, table)
    if attitude is not None:
        assembly.add("attitude", time, attitude, "imuQuaternion" if fields.has("imuQuaternion[0]") else "attitude")
    _add_navigation(assembly, table)
    _add_rotors(assembly, table, motors)
    _add_secondary(assembly, table, signs, factor)


def _attitude(table: _Table, rate: Floats | None) -> Floats | None:
    """(n, 4) body FLU to a world with z up; None where the log has none.

    Of angles, those signs of pitch and heading are taken that close with the gyro.
    """
    vector = table.array("imuQuaternion")
    if vector.shape[1] == 3:
        return quaternion_of_vector_part(vector / _QUATERNION_ONE)
    angles = table.array("attitude") * _TENTHS
    if angles.shape[1] != 3:
        return None
    candidates = [
        quaternion.from_euler(angles[:, 0], pitch * angles[:, 1], np.pi / 2 - heading * angles[:, 2])
        for pitch in (1.0, -1.0)
        for heading in (1.0, -1.0)
    ]
    if rate is None or len(table.time) < 2:
        return candidates[0]
    return max(candidates, key=lambda attitude: _closure(table.time, rate, attitude)[0])


def _turning(time: Floats, attitude: Floats) -> tuple[int, Floats]:
    """Rows of a span, and the mean body rates over each span (n - rows, 3), rad/s."""
    period = median(np.diff(time))
    rows = int(np.clip(round(_SPAN / period) if period > 0 else 1, 1, max(1, len(time) - 1)))
    step = quaternion.multiply(quaternion.conjugate(attitude[:-rows]), attitude[rows:])
    step = step * np.where(step[:, :1] < 0, -1.0, 1.0)
    return rows, quaternion.logarithm(step) / (time[rows:] - time[:-rows])[:, None]


def _over_spans(values: Floats, rows: int) -> Floats:
    """Means of the rows of each span."""
    total = np.cumsum(np.nan_to_num(values), axis=0)
    return np.asarray((total[rows:] - total[:-rows]) / rows)


def _closure(time: Floats, rate: Floats, attitude: Floats) -> tuple[float, float]:
    """Correlation about zero of rates and the attitude's turning, and their ratio; 0 where nothing turns."""
    rows, turning = _turning(time, attitude)
    mean = _over_spans(rate, rows)
    valid = np.isfinite(turning).all(axis=1) & np.isfinite(mean).all(axis=1)
    turning, mean = turning[valid], mean[valid]
    power, power_of_gyro = float(np.sum(turning**2)), float(np.sum(mean**2))
    if not len(turning) or np.sqrt(power / len(turning)) < _MIN_TURNING or power_of_gyro == 0:
        return 0.0, 0.0
    product = float(np.sum(turning * mean))
    return product / np.sqrt(power * power_of_gyro), product / power


def _gyro_signs(time: Floats, rate: Floats, attitude: Floats | None, motors: Floats) -> tuple[Floats, str]:
    """The gyro's signs to x forward, y left, z up, and what they rest on."""
    if attitude is not None:
        left, right = (_closure(time, rate * signs, attitude)[0] for signs in (_FLU, _FRD))
        if max(left, right) > _CLOSES:
            closes, other = max(left, right), min(left, right)
            shown = f"it closes with the attitude (correlation {closes:.2f}, the other way {other:.2f})"
            return (_FLU if left >= right else _FRD), shown
    if motors.shape[1] == len(OUR_ORDER):
        nose_down = motors[:, 0] + motors[:, 2] - motors[:, 1] - motors[:, 3]
        shown_by_motors = _acceleration_with(time, rate[:, 1], nose_down)
        if abs(shown_by_motors) > _MOTORS_SHOW:
            signs = _FLU if shown_by_motors > 0 else _FRD
            return signs, f"the rear motors turn the nose down (correlation {abs(shown_by_motors):.2f})"
    return _FLU, "by the firmware's definition; the log shows too little turning to check it"


def _acceleration_with(time: Floats, rate: Floats, difference: Floats) -> float:
    """Correlation of angular acceleration with the difference of motors, both over spans."""
    period = median(np.diff(time))
    rows = int(np.clip(round(_SPAN / period) if period > 0 else 1, 1, max(1, len(time) - 1)))
    step, mean = rate[rows:] - rate[:-rows], _over_spans(difference[:, None], rows)[:, 0]
    valid = np.isfinite(step) & np.isfinite(mean)
    if not valid.any():
        return 0.0
    step, mean = step[valid] - step[valid].mean(), mean[valid] - mean[valid].mean()
    size = np.sqrt(np.sum(step**2) * np.sum(mean**2))
    return float(np.sum(step * mean) / size) if size > 0 else 0.0


def _is_in_tenths(time: Floats, rate: Floats, attitude: Floats) -> bool:
    closes, ratio = _closure(time, rate, attitude)
    return closes > _CLOSES and _HIGH_RESOLUTION[0] < ratio < _HIGH_RESOLUTION[1]


def _add_force(assembly: Assembly, table: _Table) -> None:
    field = "accSmooth" if table.fields.has("accSmooth[0]") else "accADC"
    raw = table.array(field)
    if raw.shape[1] != 3:
        return
    factor = table.fields.factor(f"{field}[0]")
    if factor is None:
        gravity, note = one_g(table.fields, raw)
        factor = GRAVITY / gravity
        if note:
            assembly.note(note)
    force = raw * factor
    if median(force[:, 2]) < 0:
        force = frames.flu_from_frd(force)
        assembly.repair("force_frd_to_flu", f"{field}: the specific force points down, so it is FRD")
    assembly.add("specific_force", table.time, force, field)


def _add_navigation(assembly: Assembly, table: _Table) -> None:
    """INAV's position and velocity: centimetres north, east and up."""
    for name, field in (("position", "navPos"), ("velocity", "navVel")):
        values = table.array(field)
        if values.shape[1] == 3:
            assembly.add(name, table.time, values[:, [1, 0, 2]] * 1e-2, field)


def _add_rotors(assembly: Assembly, table: _Table, motors: Floats) -> None:
    electrical = table.array("eRPM")
    if electrical.shape[1]:
        stated = table.fields.number("motor_poles")
        poles = stated if stated is not None and stated >= 2 else float(POLES)
        why = (
            "as stated"
            if poles == stated
            else "the usual number, for the log states none; else map eRPM with pole_pairs"
        )
        assembly.note(f"rotor speeds are eRPM times 100 over the pole pairs of {poles:.0f} poles ({why})")
        assembly.add("rotor_speed", table.time, _in_our_order(electrical) * (100 * RPM / (poles / 2)), "eRPM")
    if motors.shape[1]:
        (low, high), why = motor_range(table.fields, motors)
        assembly.note(f"motor commands are {why}")
        command = np.clip((_in_our_order(motors) - low) / (high - low), 0.0, 1.0)
        assembly.add("rotor_command", table.time, command, "motor")
    if len(OUR_ORDER) in (electrical.shape[1], motors.shape[1]):
        assembly.note(
            "motors put in our order as Betaflight's quad x: 1 back right, 2 front right, 3 back left, 4 front left"
        )


def _in_our_order(motors: Floats) -> Floats:
    return motors[:, list(OUR_ORDER)] if motors.shape[1] == len(OUR_ORDER) else motors


def _add_secondary(assembly: Assembly, table: _Table, signs: Floats, gyro_factor: float) -> None:
    fields = table.fields
    for name, names, raw_factor in (
        ("battery_voltage", ("vbatLatest", "vbat"), _raw_volts),
        ("battery_current", ("amperageLatest", "amperage"), lambda _: 0.01),
    ):
        field = next((field for field in names if fields.has(field)), None)
        if field is not None and (column := fields.columns[field]) in table.column:
            values = table.column[column]
            assembly.add(name, table.time, values * (fields.factor(field) or raw_factor(values)), field)
    setpoint = table.array("setpoint")
    if setpoint.shape[1] >= 3:
        assembly.add("rate_setpoint", table.time, setpoint[:, :3] * signs * gyro_factor, "setpoint")


def _raw_volts(values: Floats) -> float:
    """Volts of one unit: hundredths, or tenths in old logs."""
    return 0.01 if median(values) > 280 else 0.1
