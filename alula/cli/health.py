"""The health of a flight as `alula inspect` prints it: two sentences, what to do, statements, events."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import msgspec
from rich.text import Text

from alula.cli.console import Console

if TYPE_CHECKING:
    from flights.health import Health
    from flights.quality import Inspection

COLOURS = {"fault": "red", "warning": "yellow", "note": "dim"}
SHOWN = 24  # events without --all


def print_health(health: Health, console: Console, *, everything: bool, muted: bool = False) -> None:
    """The two sentences and what to do, then what they rest on; notes and all events with `everything`."""
    if muted:
        return
    for sentence in health.sentences:
        console.print(sentence, highlight=False, markup=False, style="bold" if health.first else "")
    for advice in health.advice:
        console.print(f"do: {advice}", highlight=False, markup=False)
    for statement in health.statements:
        if everything or statement.level != "note":
            shown = f", {statement.certainty}: {statement.text} ({statement.evidence})"
            console.print(Text.assemble((statement.level, COLOURS[statement.level]), shown), highlight=False)
    events = health.events if everything else health.events[:SHOWN] if health.first else ()
    for event in events:
        console.print(f"  {event.time:8.2f} s  {event.text}", style="dim", highlight=False, markup=False)
    left_out = len(health.events) - len(events) if health.first else 0
    if left_out > 0:
        console.print(f"  and {left_out} more events (--all)", style="dim", highlight=False)


def with_health(inspections: Sequence[Inspection], answers: Sequence[Health]) -> list[dict[str, Any]]:
    """The inspections as plain data, each with its health beside what is there."""
    plain = [msgspec.to_builtins(inspection, str_keys=True) for inspection in inspections]
    return [
        {**inspection, "health": msgspec.to_builtins(health)} for inspection, health in zip(plain, answers, strict=True)
    ]
