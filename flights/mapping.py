"""Column mappings: what a foreign table's columns mean, as a TOML file."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping as Table
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec
import numpy as np

from dynamics.decoding import parse_toml
from dynamics.errors import RequestError
from dynamics.field_errors import described
from dynamics.spelling import nearest
from dynamics.units import RPM
from dynamics.vehicle import GRAVITY
from dynamics.vehicle_file import refuse_unknown_keys
from flights.quantities import MAX_ROTORS, QUANTITIES
from flights.stream_repair import StreamRepair
from flights.table_time import UNITS as UNITS_OF_TIME
from flights.table_time import TimeColumns

FOLDER = Path(__file__).parent / "mappings"
Kind = TypeVar("Kind", bound=msgspec.Struct)

TEXT_TIME = "iso"  # unit of times as text
# Factor from a unit to the quantity's own unit.
UNITS: Table[str, float] = {
    "m": 1.0, "mm": 1e-3, "cm": 1e-2, "m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "rad": 1.0, "deg": np.pi / 180,
    "rad/s": 1.0, "deg/s": np.pi / 180, "m/s^2": 1.0, "g": GRAVITY, "N": 1.0, "N m": 1.0, "rpm": RPM,
    "V": 1.0, "mV": 1e-3, "A": 1.0, "mA": 1e-3, "1": 1.0, "0..1": 1.0, "%": 0.01, "0..65535": 1 / 65_535,
}  # fmt: skip
# Units that a mapping may name for each unit of a quantity.
_KIND_OF_UNIT: Table[str, tuple[str, ...]] = {
    "m": ("m", "mm", "cm"), "m/s": ("m/s", "mm/s", "cm/s"), "rad": ("rad", "deg"),
    "rad/s": ("rad/s", "deg/s", "rpm"), "m/s^2": ("m/s^2", "g"), "N": ("N",), "N m": ("N m",), "V": ("V", "mV"),
    "A": ("A", "mA"), "0..1": ("0..1", "1", "%", "0..65535"), "1": ("1", "rad", "deg"), "0 or 1": ("1",),
}  # fmt: skip

_RANGE = re.compile(r"(-?\d+(?:\.\d+)?)\.\.(-?\d+(?:\.\d+)?)$")
# Axes that a mapping may name for each frame of a quantity; an attitude has those of [frames].
_AXES: Table[str, tuple[str, str]] = {"world ENU": ("ENU", "NED"), "body FLU": ("FLU", "FRD")}


class FileLayout(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Layout of the text.

    decimal: what stands before the fraction of a number.
    prefix: regular expression of what precedes the cells in every line.
    """

    delimiter: str = ","
    decimal: Literal[".", ","] = "."
    prefix: str = ""


class TimeColumn(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The column of time.

    unit: iso for times as text (2026-04-01T10:22:31.250, 01.04.2026 10:22:31,250, 10:22:31.250).
    fraction: column of what a second has beyond the whole ones, where that is a column of its own.
    from_first_row: count from the first row, for clocks that start long before the log.
    """

    column: str
    unit: Literal["s", "ms", "us", "ns", "iso"] = "s"
    fraction: str = ""
    fraction_unit: Literal["ms", "us", "ns"] = "ns"
    from_first_row: bool = True

    def __post_init__(self) -> None:
        """Refuse a fraction beside a time that has it."""
        if self.fraction and self.unit != "s":
            raise RequestError(f"time: fraction goes with a column in whole s, not in {self.unit}. Leave it out.")

    @property
    def columns(self) -> TimeColumns:
        """The columns with their units in seconds."""
        is_text = self.unit == TEXT_TIME
        unit = 1.0 if is_text else UNITS_OF_TIME[self.unit]
        return TimeColumns(self.column, unit, self.fraction, UNITS_OF_TIME[self.fraction_unit], is_text)


class Frames(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The axes of vectors in the world and on the body; the attitude turns from one to the other."""

    world: Literal["ENU", "NED"]
    body: Literal["FLU", "FRD"]


class MappedStream(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One quantity's columns.

    columns: in the order of its parts; rotors in the vehicle file's order. p[0] is the first element of a column p
        whose cells are lists.
    unit: of the columns; the quantity's own by default. Commands may be in a range, as "48..2047" for 0 to 1.
    offset: in the columns' own numbers, subtracted before anything else.
    scale: further factor.
    pole_pairs: of the motors, where rotor speeds are electrical.
    order: of an attitude: wxyz, xyzw, xyz where w was left out (0 or more), or euler for roll, pitch and yaw.
    frame: when it differs from [frames].
    """

    quantity: str
    columns: tuple[str, ...]
    unit: str = ""
    offset: float | tuple[float, ...] = 0.0
    scale: float | tuple[float, ...] = 1.0
    pole_pairs: float = 1.0
    order: Literal["", "wxyz", "xyzw", "xyz", "euler"] = ""
    frame: Literal["", "ENU", "NED", "FLU", "FRD"] = ""

    def __post_init__(self) -> None:
        """Refuse what is no quantity, has the wrong number of columns, or an impossible unit."""
        if self.quantity not in QUANTITIES:
            raise RequestError(
                f"unknown quantity {self.quantity!r}{nearest(self.quantity, QUANTITIES)}. "
                f"Known: {', '.join(QUANTITIES)}."
            )
        quantity = QUANTITIES[self.quantity]
        parts = quantity.parts
        count = None if parts is None else max(1, len(parts))
        if parts == ("w", "x", "y", "z"):
            count = 3 if self.order in ("euler", "xyz") else 4
            if not self.order:
                raise RequestError(
                    f"{self.quantity}: give order = 'wxyz', 'xyzw', 'xyz' (w left out) or 'euler'; it cannot be "
                    "guessed."
                )
        elif self.order:
            raise RequestError(f"{self.quantity} is no attitude: leave order out.")
        if count is None and not 1 <= len(self.columns) <= MAX_ROTORS:
            raise RequestError(f"{self.quantity}: give one column a rotor, 1 to {MAX_ROTORS} of them.")
        if count is not None and len(self.columns) != count:
            raise RequestError(
                f"{self.quantity} has {count} columns; {len(self.columns)} are given.{self._advice(count)}"
            )
        axes = _AXES.get(quantity.frame, ())
        if self.frame and self.frame not in axes:
            usual = f"{' or '.join(axes)} fits" if axes else "it has no axes of its own"
            raise RequestError(
                f"{self.quantity}: frame {self.frame!r} does not fit; {usual}. Correct it, or leave it out."
            )
        units = _KIND_OF_UNIT[quantity.unit]
        if self.unit and self.unit not in units and self.range is None:
            ranges = ", or a range such as '1000..2000'" if quantity.unit == "0..1" else ""
            raise RequestError(f"{self.quantity}: unknown unit {self.unit!r}; expected {_one_of(units)}{ranges}.")
        for name, value in (("scale", self.scale), ("offset", self.offset)):
            if isinstance(value, tuple) and len(value) != len(self.columns):
                raise RequestError(f"{self.quantity}: give one {name}, or one a column.")
        if self.pole_pairs != 1.0 and (quantity.parts is not None or quantity.unit != "rad/s"):
            raise RequestError(f"{self.quantity} is no rotor speed: leave pole_pairs out.")
        if not self.pole_pairs >= 1.0:
            raise RequestError(f"{self.quantity}: pole_pairs = {self.pole_pairs:g}; give 1 or more, 7 for 14 poles.")

    def _advice(self, count: int) -> str:
        """Advice where one column may stand for all, or w was left out."""
        if len(self.columns) == 3 and count == 4:
            return " If w was left out, give order = 'xyz'."
        if len(self.columns) != 1:
            return ""
        names = ", ".join(f'"{self.columns[0]}[{index}]"' for index in range(count))
        return f" If the cells of {self.columns[0]} are lists, name their elements: [{names}]."

    @property
    def range(self) -> tuple[float, float] | None:
        """The numbers of a command of 0 and of 1, None for a unit that is no range."""
        match = _RANGE.match(self.unit) if QUANTITIES[self.quantity].unit == "0..1" else None
        if match is None or self.unit in UNITS:
            return None
        low, high = float(match[1]), float(match[2])
        return (low, high) if low != high else None

    @property
    def frame_of_quantity(self) -> str:
        """The frame that the quantity has in a flight."""
        return QUANTITIES[self.quantity].frame


class Mapping(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A column mapping.

    pose: where position, velocity and attitude come from; empty where the tool writes either.
    repairs: of the streams once they are read, see `flights.stream_repair`.
    """

    name: str
    time: TimeColumn
    frames: Frames
    streams: tuple[MappedStream, ...]
    description: str = ""
    pose: Literal["", "motion_capture", "estimator"] = ""
    file: FileLayout = FileLayout()
    repairs: tuple[StreamRepair, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Every column that it needs."""
        return (*self.time.columns.names, *(column for stream in self.streams for column in stream.columns))


def _one_of(names: tuple[str, ...]) -> str:
    """Names as a choice: "m, mm or cm"."""
    *first, last = names
    return f"{', '.join(first)} or {last}" if first else last


class RepairFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A mapping file without columns: repairs of logs of any format."""

    name: str
    repairs: tuple[StreamRepair, ...]
    description: str = ""


def read_mapping(path: Path) -> Mapping:
    """A mapping of columns from its file. Raises RequestError when it cannot be read or is wrong."""
    mapping = _converted(_table(path), path, Mapping)
    try:
        re.compile(mapping.file.prefix)
    except re.error as error:
        raise RequestError(f"{path}: {described(error)}. See flights/mappings/.") from None
    if mapping.file.decimal == mapping.file.delimiter:
        raise RequestError(f"{path}: decimal and delimiter are both {mapping.file.decimal!r}. Give delimiter = ';'.")
    if len(mapping.file.delimiter) != 1:
        raise RequestError(f"{path}: delimiter {mapping.file.delimiter!r} must be one character.")
    return mapping


def read_repairs(path: Path) -> tuple[bool, tuple[StreamRepair, ...]]:
    """Whether a mapping file maps columns, and its repairs. Raises RequestError as `read_mapping`."""
    table = _table(path)
    if "repairs" in table and "streams" not in table:
        return False, _converted(table, path, RepairFile).repairs
    return True, read_mapping(path).repairs


def _table(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise RequestError(f"cannot read the column mapping {path}: {error}. See flights/mappings/.") from None


def _converted(table: dict[str, Any], path: Path, kind: type[Kind]) -> Kind:
    try:
        refuse_unknown_keys(table, kind)
        return msgspec.convert(table, kind)
    except RequestError as error:
        raise RequestError(f"{path}: {error}") from None
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, RequestError):
            raise RequestError(f"{path}: {error.__cause__}") from None
        raise RequestError(f"{path}: {described(error)}. See flights/mappings/.") from None


@cache
def shipped() -> tuple[Mapping, ...]:
    """The mappings that come with Alula, those with the most columns first."""
    mappings = [read_mapping(path) for path in sorted(FOLDER.glob("*.toml"))]
    return tuple(sorted(mappings, key=lambda mapping: -len(mapping.columns)))
