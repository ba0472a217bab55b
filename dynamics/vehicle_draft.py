"""A vehicle in the making: its numbers, each with where it comes from and how far it may be off.

`alula vehicle new` and `alula vehicle from-log` make one; written as a vehicle file it keeps both as comments.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Literal

import msgspec

from dynamics.errors import RequestError
from dynamics.vehicle import Vehicle
from dynamics.vehicle_editing import rounded
from dynamics.vehicle_file import parse_vehicle

Source = Literal["given", "parameters", "flights", "rule", "assumed"]
SECTIONS = ("body", "rotors", "limits")
COMMENT_COLUMN = 42  # of a line's unit


class Entry(msgspec.Struct, frozen=True):
    """One number of a vehicle, or a row of them.

    key: in the vehicle file, as "body.mass"; that of an effect is "effects.NAME.PARAMETER".
    value: None where it is open.
    unit: SI.
    source: "given" by the user, stated by the autopilot's "parameters", estimated from "flights", by a "rule" from
        other numbers, or "assumed".
    origin: the same in words.
    uncertainty: half of the interval of 95 %, in the unit, one for each value; empty where none is known.
    """

    key: str
    value: float | list[float] | list[list[float]] | list[int] | None
    unit: str
    source: Source
    origin: str
    uncertainty: tuple[float, ...] = ()

    @property
    def described(self) -> str:
        """Source and origin in words."""
        return ": ".join(filter(None, (self.source, self.origin)))

    @property
    def interval(self) -> str:
        """ "+- 0.1", or one for each value; empty where it is not known."""
        return f"+- {', '.join(f'{value:.2g}' for value in self.uncertainty)}" if self.uncertainty else ""


class Draft(msgspec.Struct, frozen=True):
    """A vehicle's numbers and what is still open.

    open: what cannot be told, and what would tell it, one sentence each.
    notes: to the user.
    command: that made it.
    """

    name: str
    entries: tuple[Entry, ...]
    open: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    command: str = ""

    def entry(self, key: str) -> Entry | None:
        """The entry of a key, None where there is none."""
        return next((entry for entry in self.entries if entry.key == key), None)

    @property
    def is_complete(self) -> bool:
        """Whether no number is open."""
        return all(entry.value is not None for entry in self.entries)

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle. Raises RequestError where a number is open or it cannot exist."""
        missing = [entry.key for entry in self.entries if entry.value is None]
        if missing:
            raise RequestError(f"{', '.join(missing)} is open: no vehicle file without it.")
        return parse_vehicle(self.toml)

    @property
    def toml(self) -> str:
        """The text of its vehicle file: each number below a comment with its source and interval."""
        lines = [f"# Made by `{self.command}`." if self.command else "# A draft.", "# Intervals are of 95 %."]
        lines += [f"# Open: {text}" for text in self.open]
        lines += ["", f"name = {json.dumps(self.name)}"]
        for section in SECTIONS:
            own = [entry for entry in self.entries if entry.key.startswith(f"{section}.")]
            if own:
                lines += ["", f"[{section}]", *_assignments(own)]
        effects = [entry for entry in self.entries if entry.key.startswith("effects.")]
        for name in dict.fromkeys(entry.key.split(".")[1] for entry in effects):
            lines += ["", "[[effects]]", f"name = {json.dumps(name)}", "[effects.parameters]"]
            lines += _assignments(entry for entry in effects if entry.key.split(".")[1] == name)
        return "\n".join(lines) + "\n"


def _assignments(entries: Iterable[Entry]) -> Iterator[str]:
    for entry in entries:
        interval = f", {entry.interval}" if entry.interval else ""
        assignment = f"{entry.key.rpartition('.')[2]} = {_literal(entry.value)}"
        same_line = entry.unit and len(assignment) < COMMENT_COLUMN
        yield f"# {entry.described}{interval}" + (f"; {entry.unit}" if entry.unit and not same_line else "")
        yield f"{assignment:<{COMMENT_COLUMN}}# {entry.unit}" if same_line else assignment


def _literal(value: Any) -> str:
    """A number or rows of numbers as TOML has them, four significant digits."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(_literal(item) for item in value)}]"
    return repr(float(rounded(value))) if isinstance(value, float) else repr(value)
