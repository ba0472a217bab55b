"""The shape of a target: a reader, and small valid inputs that mutations begin from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.fuzz.mutation import Parts


def one_file(parts: Parts, folder: Path) -> Path:
    """Write an input of one part, whose name is the file's."""
    ((name, content),) = parts.items()
    (folder / name).write_bytes(content)
    return folder / name


def files_in_folder(parts: Parts, folder: Path) -> Path:
    """Write an input whose parts are the files of a folder."""
    for name, content in parts.items():
        path = folder / "input" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder / "input"


@dataclass(frozen=True)
class Target:
    """A reader to be fuzzed.

    seeds: makes the valid inputs, in an empty folder that it may use.
    read: of a path; returns anything, or raises an error of ours.
    assemble: writes an input into an empty folder.
    executions: inputs of a round, as many as are read in about two seconds.
    """

    name: str
    seeds: Callable[[Path], list[Parts]]
    read: Callable[[Path], Any]
    assemble: Callable[[Parts, Path], Path] = one_file
    executions: int = 40
