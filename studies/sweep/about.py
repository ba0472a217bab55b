"""Origin of the cells in a sweep's folder."""

from __future__ import annotations

from pathlib import Path

import msgspec

from dynamics.decoding import decode_json

ABOUT = "sweep.about"


class SweepAbout(msgspec.Struct, frozen=True):
    """Origin of the cells of a folder. along: the quantities in which they differ. count: of the cells."""

    study: str
    along: tuple[str, ...]
    count: int


def read_about(folder: Path) -> SweepAbout | None:
    """Origin of the cells of a folder; None for a folder that holds no sweep."""
    try:
        return decode_json((folder / ABOUT).read_bytes(), SweepAbout)
    except (OSError, msgspec.MsgspecError):
        return None
