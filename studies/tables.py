"""Tables for the terminal, for spreadsheets, for Markdown."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import msgspec
from rich.table import Table as RichTable

from dynamics.files import write_whole

TableCell = str | int | float | None


class Table(msgspec.Struct, frozen=True):
    """A table.

    name: of its file.
    headings: with units.
    rows: as long as the headings.
    note: for the reader.
    digits: significant ones of numbers, for people; files have all of them.
    """

    name: str
    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[TableCell, ...], ...]
    note: str = ""
    digits: int = 3


def shown(cell: TableCell, digits: int = 3) -> str:
    """A cell for people: this number of significant digits, without an exponent for large numbers."""
    if cell is None or cell != cell:  # NaN is not itself
        return ""
    if not isinstance(cell, float):
        return str(cell)
    text = f"{cell:.{digits}g}"
    return f"{cell:.0f}" if "e+" in text else text


def terminal_table(table: Table) -> RichTable:
    """For rich to print; columns of numbers to the right."""
    made = RichTable(title=table.title, title_justify="left", caption=table.note or None, caption_justify="left")
    for place, heading in enumerate(table.headings):
        numeric = all(not isinstance(row[place], str) for row in table.rows)
        made.add_column(heading, justify="right" if numeric else "left", overflow="fold")
    for row in table.rows:
        made.add_row(*(shown(cell, table.digits) for cell in row))
    return made


def markdown(table: Table) -> str:
    """The table with its title and note."""
    lines = [table.headings, ("---",) * len(table.headings)]
    lines += [tuple(shown(cell, table.digits) for cell in row) for row in table.rows]
    body = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    return "\n\n".join(part for part in (f"**{table.title}**", body, table.note) if part)


def write_csv(tables: Sequence[Table], folder: Path) -> list[Path]:
    """One file a table, NAME.csv. Raises RequestError when the folder cannot be written to."""
    return [
        write_whole(folder / f"{table.name}.csv", partial(_write_rows, table), advice="Give another --csv.")
        for table in tables
    ]


def _write_rows(table: Table, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([table.headings, *table.rows])
