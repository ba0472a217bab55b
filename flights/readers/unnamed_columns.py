"""Columns of a table that nothing names and that may be rotors or an accelerometer, by the words in their names."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynamics.arrays import Floats
from flights.assembly import Assembly

_NUMBER = re.compile(r"\d+(?!.*\d)")  # the last one of a name
_AXIS = re.compile(r"(?<![a-z])[xyz](?![a-z])|(?<=acc)[xyz]$|[XYZ]$")
_SPEED = re.compile(r"rpm|omega|(rotor|motor|prop).*(speed|vel)|(speed|vel).*(rotor|motor|prop)", re.IGNORECASE)
_COMMAND = re.compile(r"motor|rotor|pwm|throttle|servo|esc|actuator|dshot|(^|[^a-z])m\d$", re.IGNORECASE)
_OTHER = re.compile(r"temp|volt|curr|status|state|error|count|function|address", re.IGNORECASE)
_FORCE = re.compile(r"acc", re.IGNORECASE)
_MIN_ROTORS = 2


@dataclass(frozen=True)
class UnnamedColumns:
    """Columns of one kind.

    quantity: which they may be.
    names: of the columns, in the table's order.
    """

    quantity: str
    names: tuple[str, ...]


def unnamed_columns(names: Sequence[str], used: Collection[str]) -> tuple[UnnamedColumns, ...]:
    """Groups of columns by their names. names: of all columns. used: those that are a flight's, or mapped."""
    groups: dict[tuple[str, str], list[str]] = {}
    for name in dict.fromkeys(names):
        if name in used or _OTHER.search(name):
            continue
        if _FORCE.search(name) and _AXIS.search(name):
            groups.setdefault(("specific_force", _AXIS.sub("#", name)), []).append(name)
        elif _NUMBER.search(name) and (_SPEED.search(name) or _COMMAND.search(name)):
            quantity = "rotor_speed" if _SPEED.search(name) else "rotor_command"
            groups.setdefault((quantity, _NUMBER.sub("#", name)), []).append(name)
    return tuple(
        UnnamedColumns(quantity, tuple(group))
        for (quantity, _), group in groups.items()
        if (len(group) == 3 if quantity == "specific_force" else len(group) >= _MIN_ROTORS)
    )


def columns_of(groups: Sequence[UnnamedColumns]) -> list[str]:
    """The names of all columns of some groups."""
    return [name for group in groups for name in group.names]


def keep_unnamed(assembly: Assembly, groups: Sequence[UnnamedColumns], columns: Mapping[str, Floats]) -> None:
    """Keep groups of columns as unused. columns: by name; those that hold no numbers are not among them."""
    for group in groups:
        if columns.keys() >= set(group.names):
            table = np.stack([columns[name] for name in group.names], axis=1)
            reason = "no column of the flight CSV and no mapping names them, with unit and order"
            assembly.leave_out(group.quantity, "table", group.names, table, reason)
