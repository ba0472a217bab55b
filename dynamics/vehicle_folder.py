"""Vehicle files that lie in a folder, recognised by their content."""

from __future__ import annotations

import tomllib
from pathlib import Path

from dynamics.decoding import parse_toml

PARTS_OF_A_VEHICLE = ("body", "rotors")  # tables by which its file is recognised


def vehicle_files_in(folder: Path) -> list[Path]:
    """The vehicle files of a folder, not of those below it, in the order of their names."""
    return [path for path in sorted(folder.glob("*.toml")) if describes_vehicle(path)]


def describes_vehicle(path: Path) -> bool:
    """Whether a TOML file has a vehicle's tables, right or wrong."""
    try:
        table = parse_toml(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        return False
    return all(part in table for part in PARTS_OF_A_VEHICLE)
