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

FOLDER = Path(__file__).parent / "mappings"
Kind = TypeVar("Kind", bound=msgspec.Struct)

TIME_UNITS: Table[str, float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
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

# Axes that a mapping may name for each frame of a quantity; an attitude has those of [frames].
_AXES: Table[str, tuple[str, str]] = {"world ENU": ("ENU", "NED"), "body FLU": ("FLU", "FRD")}


class FileLayout(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Layout of the text.

    prefix: regular expression of what precedes the cells in every line.
    """

    delimiter: str = ","
    prefix: str = ""


class TimeColumn(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The column of time.

    from_first_row: count from the first row, for clocks that start long before the log.
    """

    column: str
    unit: Literal["s", "ms", "us", "ns"] = "s"
    from_first_row: bool = True


class Frames(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The axes of vectors in the world and on the body; the attitude turns from one to the other."""

    world: Literal["ENU", "NED"]
    body: Literal["FLU", "FRD"]


class MappedStream(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One quantity's columns.

    columns: in the order of its parts; rotors in the vehicle file's order.
    unit: of the columns; the quantity's own by default.
    scale: further factor.
    order: of an attitude: wxyz, xyzw, or euler for roll, pitch and yaw.
    frame: when it differs from [frames].
    """

    quantity: str
    columns: tuple[str, ...]
    unit: str = ""
    scale: float | tuple[float, ...] = 1.0
    order: Literal["", "wxyz", "xyzw", "euler"] = ""
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
            count = 3 if self.order == "euler" else 4
            if not self.order:
                raise RequestError(f"{self.quantity}: give order = 'wxyz', 'xyzw' or 'euler'; it cannot be guessed.")
        elif self.order:
            raise RequestError(f"{self.quantity} is no attitude: leave order out.")
        if count is None and not 1 <= len(self.columns) <= MAX_ROTORS:
            raise RequestError(f"{self.quantity}: give one column a rotor, 1 to {MAX_ROTORS} of them.")
        if count is not None and len(self.columns) != count:
            raise RequestError(f"{self.quantity} has {count} columns; {len(self.columns)} are given.")
        axes = _AXES.get(quantity.frame, ())
        if self.frame and self.frame not in axes:
            usual = f"{' or '.join(axes)} fits" if axes else "it has no axes of its own"
            raise RequestError(
                f"{self.quantity}: frame {self.frame!r} does not fit; {usual}. Correct it, or leave it out."
            )
        units = _KIND_OF_UNIT[quantity.unit]
        if self.unit and self.unit not in units:
            raise RequestError(f"{self.quantity}: unknown unit {self.unit!r}; expected {_one_of(units)}.")
        if isinstance(self.scale, tuple) and len(self.scale) != len(self.columns):
            raise RequestError(f"{self.quantity}: give one scale, or one a column.")

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
        return (self.time.column, *(column for stream in self.streams for column in stream.columns))


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
