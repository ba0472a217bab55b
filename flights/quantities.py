"""The quantities a flight consists of: their columns, units and frames, and how each may be resampled."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

from dynamics.errors import DataError

Kind = Literal["linear", "attitude", "step"]
MAX_ROTORS = 16
_ROTOR_COLUMN = re.compile(r"_(0|[1-9]\d*)$")


@dataclass(frozen=True)
class Quantity:
    """One physical quantity.

    parts: suffixes of its columns, empty for a scalar, None for one column a rotor.
    frame: world ENU, body FLU, or empty.
    kind: interpolation between two samples: linear, on the unit sphere, or held.
    """

    name: str
    parts: tuple[str, ...] | None
    unit: str
    frame: str = ""
    kind: Kind = "linear"

    def columns(self, width: int) -> tuple[str, ...]:
        """The names of its columns. width: their number, which only differs from `parts` for rotors."""
        if self.parts is None:
            return tuple(f"{self.name}_{rotor}" for rotor in range(width))
        return tuple(f"{self.name}_{part}" for part in self.parts) if self.parts else (self.name,)


_XYZ = ("x", "y", "z")
_WXYZ = ("w", "x", "y", "z")

# In the order of the flight CSV; what every flight needs comes first.
QUANTITIES: Mapping[str, Quantity] = {
    quantity.name: quantity
    for quantity in (
        Quantity("position", _XYZ, "m", "world ENU"),
        Quantity("velocity", _XYZ, "m/s", "world ENU"),
        Quantity("attitude", _WXYZ, "1", "body FLU to world ENU", "attitude"),
        Quantity("rate", _XYZ, "rad/s", "body FLU"),
        Quantity("specific_force", _XYZ, "m/s^2", "body FLU"),
        Quantity("acceleration", _XYZ, "m/s^2", "world ENU"),
        Quantity("roll", (), "rad"),
        Quantity("pitch", (), "rad"),
        Quantity("yaw", (), "rad"),
        Quantity("rotor_speed", None, "rad/s"),
        Quantity("rotor_speed_command", None, "rad/s"),
        Quantity("rotor_command", None, "0..1"),
        Quantity("rotor_thrust_command", None, "N"),
        Quantity("battery_voltage", (), "V", kind="step"),
        Quantity("battery_current", (), "A", kind="step"),
        Quantity("position_setpoint", _XYZ, "m", "world ENU", "step"),
        Quantity("velocity_setpoint", _XYZ, "m/s", "world ENU", "step"),
        Quantity("attitude_setpoint", _WXYZ, "1", "body FLU to world ENU", "step"),
        Quantity("rate_setpoint", _XYZ, "rad/s", "body FLU", "step"),
        Quantity("thrust_setpoint", (), "0..1", kind="step"),
        Quantity("collective_thrust_command", (), "N", kind="step"),
        Quantity("torque_command", _XYZ, "N m", "body FLU", "step"),
        Quantity("armed", (), "0 or 1", kind="step"),
        Quantity("landed", (), "0 or 1", kind="step"),
        Quantity("reset_counter", (), "1", kind="step"),
        Quantity("position_reset_counter", (), "1", kind="step"),
        Quantity("velocity_reset_counter", (), "1", kind="step"),
        Quantity("attitude_reset_counter", (), "1", kind="step"),
    )
}

MOTION = ("position", "velocity", "attitude", "rate", "specific_force")
ROTORS = tuple(name for name, quantity in QUANTITIES.items() if quantity.parts is None)
RESET_COUNTERS = tuple(name for name in QUANTITIES if name.endswith("reset_counter"))
# What the physics needs; every other quantity is secondary, and a defect of its own refuses no flight.
PRIMARY = frozenset((*MOTION, "acceleration", "roll", "pitch", "yaw", *ROTORS))

_FIXED: Mapping[str, str] = {
    column: quantity.name
    for quantity in QUANTITIES.values()
    if quantity.parts is not None
    for column in quantity.columns(len(quantity.parts))
}


def quantity_of(column: str) -> Quantity | None:
    """The quantity that a column of the flight CSV belongs to, None for a column that is none of it."""
    if column in _FIXED:
        return QUANTITIES[_FIXED[column]]
    match = _ROTOR_COLUMN.search(column)
    if match is None or int(match.group(1)) >= MAX_ROTORS or column[: match.start()] not in ROTORS:
        return None
    return QUANTITIES[column[: match.start()]]


def known_columns(rotors: int = 4) -> tuple[str, ...]:
    """Every column of the flight CSV for a number of rotors, the time excepted."""
    return tuple(column for quantity in QUANTITIES.values() for column in quantity.columns(rotors))


def all_parts(quantity: Quantity, present: Collection[str]) -> tuple[str, ...]:
    """The quantity's columns in their own order. Raises DataError when some of them are missing."""
    width = len(present) if quantity.parts is None else len(quantity.parts)
    parts = quantity.columns(width)
    missing = [part for part in parts if part not in present]
    if missing:
        raise DataError(
            f"{', '.join(missing)} missing beside {', '.join(sorted(present))}. Wanted all columns of {quantity.name} "
            "or none; rename or add them."
        )
    return parts
