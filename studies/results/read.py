"""Any result by its path."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from studies.results.kinds import kind_of, stamp
from studio.pages.shown import ResultReader, Shown


def show(path: Path) -> Shown:
    """A result as it stands. Raises RequestError and DataError for one that cannot be read."""
    reader = import_module(f"studies.results.{kind_of(path)}")  # torch and matplotlib only where they are needed
    shown: Shown = reader.show(path)
    return shown


RESULTS = ResultReader(stamp, show)
