"""A hypothesis about what a log's columns really are, with its evidence and the lines that repair it."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from flights.stream_repair import StreamRepair, toml_value


@dataclass(frozen=True)
class Hypothesis:
    """What a log's columns are, other than declared, by how well physics closes.

    name: for programs.
    text: what they are.
    evidence: what closes by it, and how far.
    repairs: what makes the columns those of a flight.
    """

    name: str
    text: str
    evidence: str
    repairs: tuple[StreamRepair, ...]

    @property
    def lines(self) -> str:
        """The repairs as one line of a mapping file."""
        tables = (msgspec.to_builtins(repair) for repair in self.repairs)
        inline = ", ".join("{" + ", ".join(f"{k} = {toml_value(v)}" for k, v in t.items()) + "}" for t in tables)
        return f"repairs = [{inline}]"

    def __str__(self) -> str:
        """Statement, evidence and repair, for people."""
        return f"{self.text} ({self.evidence}). Repair: {self.lines} in a mapping file, which --repair FILE writes."
