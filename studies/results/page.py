"""A result as one static page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from flights.source import sha256
from runtime.replay import ReplayReport
from studies.results import recording
from studio.pages.page import render, write_page
from studio.pages.provenance import origin
from studio.pages.shown import Shown


def write_recording_page(path: Path, report: ReplayReport, target: Path) -> None:
    """Write a recorded flight and its replay. Raises RequestError and DataError as the reader, and for the page."""
    shown = recording.show(path)
    replayed = f"Replayed: {'; '.join(report.lines)}."
    write_shown(replace(shown, lines=[*shown.lines, replayed]), target, inputs={path.name: sha256(path)})


def write_shown(shown: Shown, path: Path, *, inputs: Mapping[str, str]) -> None:
    """Write a result as one page. inputs: sha256 by name. Raises RequestError when it cannot be written."""
    page = render(
        "tables.html",
        title=shown.title,
        origin=origin(inputs),
        lines=shown.lines,
        tables=shown.tables,
        images=shown.images,
        pictures=shown.pictures,
    )
    write_page(page, path)
