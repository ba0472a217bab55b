"""Events of a flight: what its autopilot did and said, modes and log messages, which no column of numbers holds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Literal

import msgspec

EventKind = Literal["mode", "message"]
MAX_EVENTS = 2000  # of a log; a page lists no more
_ESCAPES = re.compile(r"\x1b\[[0-9;]*[A-Za-z]|[\x00-\x1f\x7f-\x9f]")  # colours of a terminal, control characters

# PX4's vehicle_status.nav_state (NAVIGATION_STATE_*), under the names that ground stations show.
PX4_MODES: Mapping[int, str] = {
    0: "Manual", 1: "Altitude", 2: "Position", 3: "Mission", 4: "Hold", 5: "Return", 6: "Position slow", 10: "Acro",
    12: "Descend", 13: "Termination", 14: "Offboard", 15: "Stabilized", 17: "Takeoff", 18: "Land", 19: "Follow",
    20: "Precision land", 21: "Orbit", 22: "VTOL takeoff",
}  # fmt: skip


class Event(msgspec.Struct, frozen=True):
    """A change of mode, or a message. time: s since the log's start; before it, negative."""

    time: float
    kind: EventKind
    text: str


def px4_mode(nav_state: int) -> str:
    """The name of a mode of PX4, its number where it has none here."""
    return PX4_MODES.get(nav_state, f"mode {nav_state}")


def cleaned(text: str, length: int = 300) -> str:
    """A message without a terminal's colours and control characters, cut where it is very long."""
    return _ESCAPES.sub("", text).strip()[:length]
