"""Content of a page about a result: sentences, pictures, tables, and the logs that can be opened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
