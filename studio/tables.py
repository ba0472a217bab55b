"""A page of plain tables and finished pictures, for whatever is measured in numbers alone."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

from studio.page import Origin, render

Cell = str | int | float | None


@dataclass(frozen=True)
class PageTable:
    """title, note: in words. headings: with units. rows: as long as the headings. digits: significant ones."""

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
        """For the page's source."""
        return base64.b64encode(self.png).decode()


def tables_page(
    title: str, lines: Sequence[str], tables: Sequence[PageTable], images: Sequence[Image], *, origin: Origin
) -> str:
    """A page. lines: the answer, a sentence each."""
    return render("tables.html", title=title, origin=origin, lines=lines, tables=tables, images=images)
