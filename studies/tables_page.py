"""Tables and pictures as one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from studies import figures
from studies.tables import Table
from studio.pages.page import write_page
from studio.pages.provenance import origin
from studio.pages.tables import Image, PageTable, tables_page


def write_tables_page(
    path: Path,
    title: str,
    lines: Sequence[str],
    tables: Sequence[Table],
    pictures: Sequence[tuple[Figure, str]],
    *,
    inputs: Mapping[str, str],
) -> None:
    """Write a page.

    lines: the summary, a sentence each.
    pictures: with captions.
    inputs: sha256 by name.

    Raises RequestError when it cannot be written.
    """
    images = [Image(figures.as_png(figure), caption) for figure, caption in pictures]
    shown = [as_page_table(table) for table in tables]
    write_page(tables_page(title, lines, shown, images, origin=origin(inputs)), path)


def as_page_table(table: Table) -> PageTable:
    """A study's table for a page."""
    return PageTable(table.title, table.headings, table.rows, table.note, table.digits)
