"""Pages of plain tables and PNG pictures, for results that are numbers alone."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

from studio.pages.page import Origin, render

Cell = str | int | float | None


@dataclass(frozen=True)
class PageTable:
    """A table of a page.

    title, note: texts above and below it.
    headings: of the columns, with units.
    rows: cells, one for each heading.
    digits: significant digits of numbers.
    """

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""
    digits: int = 3


@dataclass(frozen=True)
class Image:
    """A picture as PNG.

    png: its bytes.
    description: what it shows.
    """

    png: bytes
    description: str

    @property
    def base64(self) -> str:
        """The bytes as base64, for the page's source."""
        return base64.b64encode(self.png).decode()


def tables_page(
    title: str, lines: Sequence[str], tables: Sequence[PageTable], images: Sequence[Image], *, origin: Origin
) -> str:
    """A page. lines: the answer, a sentence each."""
    return render("tables.html", title=title, origin=origin, lines=lines, tables=tables, images=images, pictures={})
