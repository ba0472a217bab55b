"""The cases of `cases.toml`, numbered by seeds."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import msgspec

from dynamics.errors import RequestError

CASES = Path(__file__).with_name("cases.toml")
Source = Literal[
    "own", "mock", "campaign", "short", "outside", "px4_like", "recorded", "bundled", "statements", "mutated"
]


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A case as the file has it; which fields a source reads stands beside the sources in `posing.py`.

    name: within its set.
    seeds: how many cases, each with the next seed.
    hidden: effects and their parameters; a flown one is drawn up to a quarter larger or smaller.
    recorder: "speeds", "commands"; of a draw its kind.
    noise: factor on the usual noise of the sensors.
    files, normal: logs in the folder of the data, and normal flights to compare hover with.
    vehicle: bundled name, or a file in that folder. bare: without the effects that it names.
    hold_out: pattern of the file names that are held out.
    allowed, also: as in `scoring.Expected`.
    """

    name: str
    seeds: int = 1
    hidden: Mapping[str, Mapping[str, float]] = {}
    recorder: str = "speeds"
    noise: float = 1.0
    files: tuple[str, ...] = ()
    normal: tuple[str, ...] = ()
    vehicle: str = "arpl_250g"
    bare: bool = False
    hold_out: str | None = None
    allowed: tuple[str, ...] = ()
    also: tuple[str, ...] = ()


class CaseSet(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Cases that are scored together. title: for the table."""

    title: str
    cases: tuple[SourcedEntry, ...]


class SourcedEntry(Entry, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An entry and where its flights come from."""

    source: Source


class Case(msgspec.Struct, frozen=True):
    """One question: an entry of a set, and the seed of its flights."""

    set_name: str
    entry: SourcedEntry
    seed: int

    @property
    def key(self) -> str:
        """Unique name, good for a file."""
        recorder = "" if self.entry.recorder == "speeds" else f"{self.entry.recorder}-"
        name = re.sub(r"[^\w.-]+", "_", self.entry.name)
        return f"{self.set_name}-{recorder}{name}-{self.seed}"


def read_sets(path: Path = CASES) -> dict[str, CaseSet]:
    """The sets by name. Raises RequestError for a file that is not one of cases."""
    try:
        sets = msgspec.toml.decode(path.read_bytes(), type=dict[str, CaseSet])
    except msgspec.DecodeError as error:
        raise RequestError(f"{path}: {error}. Correct the entry; `Entry` in cases.py documents each field.") from error
    for name, each in sets.items():
        keys = [(e.recorder, e.name) for e in each.cases]
        if twice := sorted({key for key in keys if keys.count(key) > 1}):
            raise RequestError(f"{path}: set {name} has {twice} twice. Give each case a name of its own.")
    return sets


def planned(sets: Mapping[str, CaseSet], names: Sequence[str], first: int, limit: int | None) -> list[Case]:
    """The cases of the named sets, seeds from `first` on; of each set `limit` at most, evenly from all of them."""
    if unknown := sorted(set(names) - set(sets)):
        raise RequestError(f"{', '.join(unknown)}: no such set. There are {', '.join(sets)}.")
    chosen = []
    for name in names:
        cases = [Case(name, e, first + i) for e in sets[name].cases for i in range(e.seeds)]
        count = len(cases) if limit is None else min(limit, len(cases))
        chosen += [cases[(2 * i + 1) * len(cases) // (2 * count)] for i in range(count)]
    return chosen
