"""The files in a fleet's folder of results, and what they are of."""

from __future__ import annotations

from pathlib import Path

import msgspec

from dynamics.decoding import decode_json

LINES, TABLE, LOCK, ABOUT = "flights.jsonl", "flights.parquet", "flights.lock", "fleet.json"


class FleetAbout(msgspec.Struct, frozen=True):
    """Origin of the lines. folder: of the logs, absolute. count: of the logs at the last run's start."""

    folder: str
    count: int


def read_about(folder: Path) -> FleetAbout | None:
    """Origin of the lines in a folder; None for results of older versions."""
    try:
        return decode_json((folder / ABOUT).read_bytes(), FleetAbout)
    except (OSError, msgspec.MsgspecError):
        return None
