"""A recording of bounded size: several files, of which the oldest goes when a new one begins.

Each part is a whole recording of its time, with the flight's settings and attachments: `NAME.part0007.mcap`.
"""

from __future__ import annotations

import re
from pathlib import Path

MAX_PARTS = 4  # that are there at a time, with the one being written
MIN_LIMIT = 5_000_000  # bytes of all parts: a part is then many times what is written at once
PART = "part"  # key of its number in the metadata
_NAME = re.compile(r"(?P<name>.+)\.part(?P<number>\d{4,})\.mcap")


def part_path(directory: Path, name: str, number: int) -> Path:
    """The path of a part. number: from 1."""
    return directory / f"{name}.part{number:04}.mcap"


def part_bytes(limit: int) -> int:
    """Bytes after which a part ends, so that MAX_PARTS with their indices stay within a limit, bytes."""
    return limit // (MAX_PARTS + 1)


def parts_of(path: Path) -> dict[int, Path]:
    """The parts beside a part, by their numbers and in their order, itself included; empty for any other path."""
    if (own := _NAME.fullmatch(path.name)) is None:
        return {}
    siblings = (_NAME.fullmatch(each.name) for each in path.parent.glob("*.mcap"))
    return {
        int(each["number"]): path.with_name(each.string)
        for each in sorted(filter(None, siblings), key=lambda each: int(each["number"]))
        if each["name"] == own["name"]
    }
