"""Fields of a decoded blackbox, and what its header says: names, units, firmware, motor range, magnetic poles."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynamics.arrays import Floats
from dynamics.vehicle import GRAVITY

Firmware = Literal["Betaflight", "INAV", "Rotorflight"]
ITERATION, TIME = "loopIteration", "time"
_FIELD = re.compile(r"(?P<name>\w+(?:\[\d+\])?)\s*(?:\((?P<unit>[^)]*)\))?$")
_HEADER_LINE = re.compile(r"H (?P<key>[^:]+):(?P<value>.*)$")
_MAX_PREAMBLE = 400  # lines
_DSHOT, _PULSES, _PER_MILLE = (48.0, 2047.0), (1000.0, 2000.0), (0.0, 1000.0)
_PULSE_MARGIN = 20.0  # us that a pulse may lie outside of 1000 to 2000
ONE_G = 2048.0  # of accelerometers whose log does not state acc_1G
_RADIANS_PER_US = 1e-5  # a gyro_scale below it is Baseflight's, rad/us
_POWERS = tuple(2.0**power for power in range(8, 15))
_USUAL_FORCE = (0.45, 2.2)  # g; median of a flight
POLES = 14
_UNITS: Mapping[str, float] = {
    "deg/s": np.pi / 180, "rad/s": 1.0, "g": GRAVITY, "m/s2": 1.0, "m/s/s": 1.0, "m/s^2": 1.0, "v": 1.0, "mv": 1e-3,
    "a": 1.0, "ma": 1e-3, "us": 1e-6, "ms": 1e-3, "s": 1.0, "deg": np.pi / 180,
}  # fmt: skip


@dataclass(frozen=True)
class Fields:
    """The columns of a decoded blackbox by field, without their units; and the header, as far as the file has it."""

    columns: Mapping[str, str]
    units: Mapping[str, str]
    header: Mapping[str, str]

    def has(self, *names: str) -> bool:
        """Whether all fields are there."""
        return all(name in self.columns for name in names)

    def array(self, name: str) -> list[str]:
        """The columns of an array field in the order of their indices."""
        count = next(index for index in range(len(self.columns) + 1) if f"{name}[{index}]" not in self.columns)
        return [self.columns[f"{name}[{index}]"] for index in range(count)]

    def factor(self, name: str) -> float | None:
        """Factor to SI of the unit in a column's name, None where it has no unit: raw numbers."""
        return _UNITS.get(self.units.get(name, "").lower())

    def number(self, key: str) -> float | None:
        """A number of the header."""
        try:
            return float(self.header[key].split(",")[0])
        except (KeyError, ValueError):
            return None

    @property
    def firmware(self) -> Firmware:
        """The firmware by the header, or by fields that only one has."""
        stated = f"{self.header.get('Firmware revision', '')} {self.header.get('Firmware type', '')}".lower()
        if "inav" in stated or self.has("navPos[0]") or self.has("axisRate[0]"):
            return "INAV"
        if "rotorflight" in stated or self.has("headspeed") or self.has("mixer[0]"):
            return "Rotorflight"
        return "Betaflight"


def fields_of(names: Sequence[str], header: Mapping[str, str]) -> Fields:
    """Fields of a table's column names, as `gyroADC[0]` or `vbatLatest (V)`."""
    matches = [(name, match) for name in names if (match := _FIELD.match(name))]
    return Fields(
        {match["name"]: name for name, match in matches},
        {match["name"]: (match["unit"] or "").strip() for _, match in matches},
        header,
    )


def split_preamble(lines: Sequence[str]) -> tuple[int, dict[str, str]]:
    """Lines before the columns' names, -1 where there are none, and what they state: "H key:value" or "key","value"."""
    header: dict[str, str] = {}
    for number, line in enumerate(lines[:_MAX_PREAMBLE]):
        names = [name.strip().strip('"') for name in line.split(",")]
        bare = {match["name"] for name in names if (match := _FIELD.match(name))}
        if ITERATION in bare and TIME in bare:
            return number, header
        stated = _HEADER_LINE.match(line)
        if stated is not None:
            header[stated["key"].strip()] = stated["value"].strip()
        elif len(names) > 1:
            header[names[0]] = ",".join(names[1:])
    return -1, header


def median(values: Floats) -> float:
    """Median of the finite values, NaN where there are none."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else float("nan")


def gyro_scale(fields: Fields) -> float:
    """rad/s of one unit of raw gyro numbers: degrees a second, times what the header of an old log states."""
    scale = 1.0
    with suppress(KeyError, ValueError, struct.error):
        (scale,) = struct.unpack("<f", struct.pack("<I", int(fields.header["gyro_scale"], 16)))
    if not 0 < scale <= 1.0:
        scale = 1.0
    if scale < _RADIANS_PER_US:
        return float(scale * 1e6)
    return float(scale * np.pi / 180 / (10.0 if fields.number("blackbox_high_resolution") == 1.0 else 1.0))


def one_g(fields: Fields, raw: Floats) -> tuple[float, str]:
    """Raw accelerometer numbers that are one g, and a note: as stated, or 2048 where a flight's force fits that.

    raw: (n, 3).
    """
    stated = fields.number("acc_1G")
    if stated is not None and stated > 0:
        return stated, ""
    force = median(np.linalg.norm(raw, axis=1))
    if _USUAL_FORCE[0] * ONE_G < force < _USUAL_FORCE[1] * ONE_G or not force > 0:
        return ONE_G, f"accelerations are read with {ONE_G:.0f} for one g: the log does not state acc_1G"
    nearest = min(_POWERS, key=lambda one: abs(np.log(force / one)))
    return nearest, (
        f"accelerations are read with {nearest:.0f} for one g, to which their median of {force:.0f} is closest: the "
        "log does not state acc_1G"
    )


def motor_range(fields: Fields, raw: Floats) -> tuple[tuple[float, float], str]:
    """Numbers of a motor that stands still and of one at full power, and the reason. raw: (n, motors)."""
    if fields.firmware == "Rotorflight":
        return _PER_MILLE, "Rotorflight's, in thousandths"
    if fields.firmware == "INAV":
        return _PULSES, "INAV's, 1000 to 2000"
    stated = fields.header.get("motorOutput", "").split(",")
    if len(stated) == 2 and stated[1].strip().isdigit():
        full = int(stated[1])
        return (_DSHOT, "DShot, 48 to 2047") if full > _PULSES[1] + _PULSE_MARGIN else (_PULSES, "1000 to 2000")
    finite = raw[np.isfinite(raw)]
    low, high = float(finite.min(initial=np.inf)), float(finite.max(initial=-np.inf))
    if fields.array("eRPM"):
        return _DSHOT, "DShot, 48 to 2047: eRPM comes by bidirectional DShot"
    if low < _PULSES[0] - _PULSE_MARGIN or high > _PULSES[1] + _PULSE_MARGIN:
        return _DSHOT, f"DShot, 48 to 2047: they are {low:.0f} to {high:.0f}"
    if fields.has("imuQuaternion[0]"):
        return _DSHOT, "DShot, 48 to 2047, which every Betaflight that logs imuQuaternion has by default"
    return _PULSES, f"1000 to 2000: they are {low:.0f} to {high:.0f}"
