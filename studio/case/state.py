"""Content of a case's `case.json`."""

from __future__ import annotations

from typing import Annotated

import msgspec

FORMAT = 1


class CaseLog(msgspec.Struct, frozen=True):
    """A log of a case.

    path: below the case's folder, or absolute.
    size: bytes.
    sha256: of the file.
    """

    path: str
    size: int
    sha256: str


class ChannelLevel(msgspec.Struct, frozen=True):
    """RMS of a kind of channel on held-out flights before and after an addition, and its floor."""

    before: float
    after: float
    floor: float
    unit: str


class Version(msgspec.Struct, frozen=True):
    """A vehicle file of a case, and how it came about.

    number: from 1, never used twice.
    parent: the version that it was made from, 0 for the first.
    file: below the case's folder.
    action: what was done, for people.
    author: the user's name on this computer.
    date: ISO 8601, UTC.
    command: the command line that does the same.
    effects: the effects that were added or corrected, by their names in a model.
    channels: errors by kind of channel.
    data: key of the flights that they are of.
    """

    number: int
    parent: int
    file: str
    action: str
    author: str
    date: str
    command: str = ""
    effects: tuple[str, ...] = ()
    channels: dict[str, ChannelLevel] = {}
    data: str = ""


class Options(msgspec.Struct, frozen=True):
    """How a case's logs are read, as the options of `alula diagnose` of the same names."""

    mapping: str = ""
    pose: str = ""
    hold_out: str = ""
    system: Annotated[str, msgspec.Meta(pattern="^([1-9][0-9]{0,2})?$")] = ""


class CaseState(msgspec.Struct, frozen=True):
    """All that a case remembers beside its files.

    format: of this file.
    name: for people.
    vehicle: where the first version's file came from, as `--vehicle` takes it.
    effect_files: Python files below the case's folder.
    versions: every version that was made, those of an undone branch too.
    current: number of the version that is worked on, 0 before a vehicle is chosen.
    undone: numbers to go forward to, the next one last.
    shown: key of the result that was last made, by step.
    """

    format: int = FORMAT
    name: str = ""
    logs: tuple[CaseLog, ...] = ()
    vehicle: str = ""
    effect_files: tuple[str, ...] = ()
    options: Options = Options()
    versions: tuple[Version, ...] = ()
    current: int = 0
    undone: tuple[int, ...] = ()
    shown: dict[str, str] = {}
