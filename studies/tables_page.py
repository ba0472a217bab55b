"""Tables and pictures as one self-contained page."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

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
    images = []
    for figure, caption in pictures:
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=110)
        images.append(Image(buffer.getvalue(), caption))
    shown = [PageTable(t.title, t.headings, t.rows, t.note, t.digits) for t in tables]
    write_page(tables_page(title, lines, shown, images, origin=origin(inputs)), path)
