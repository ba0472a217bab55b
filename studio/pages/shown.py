"""Content of a page about a result: sentences, pictures, tables, and the logs that can be opened; and who reads it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from studio.pages.figure import Picture
from studio.pages.tables import Image, PageTable


@dataclass(frozen=True)
class Shown:
    """A result as a page shows it.

    kind: of the result, one word.
    title: of the page.
    lines: the answer, a sentence each.
    pictures: title to picture.
    images: of matplotlib.
    tables: in the order of their importance.
    logs: flights that can be opened as a case, by name.
    share: of the work that is done, 0 to 1, None for a result that is whole.
    command: that looks at the result further, or goes on with it.
    replayable: whether it is a recording that the flight logic can fly again.
    """

    kind: str
    title: str
    lines: Sequence[str]
    pictures: Mapping[str, Picture] = field(default_factory=dict)
    images: Sequence[Image] = ()
    tables: Sequence[PageTable] = ()
    logs: Mapping[str, Path] = field(default_factory=dict)
    share: float | None = None
    command: str = ""
    replayable: bool = False


@dataclass(frozen=True)
class ResultReader:
    """Reader of the results that commands leave on disk, which pages show without knowing the rooms that make them.

    stamp: of the result at a path, which changes with it.
    show: its content as it stands.

    Both raise RequestError for a path that holds no result, `show` DataError as well for one that cannot be read.
    """

    stamp: Callable[[Path], str]
    show: Callable[[Path], Shown]
