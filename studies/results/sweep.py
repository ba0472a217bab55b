"""A sweep's folder: the study's tables and pictures of the cells that are trained, also while others still are."""

from __future__ import annotations

from pathlib import Path

import msgspec

from dynamics.decoding import decode_json
from dynamics.errors import RequestError
from studies.figures import as_png
from studies.results.kinds import SWEEP
from studies.sweep.about import ABOUT, read_about
from studies.sweep.catalogue import SEARCH
from studies.sweep.cell import CellResult, FailedCell, Outcome, trained
from studies.sweep.figures import study_figures
from studies.sweep.report import summary_lines
from studies.sweep.tables import search_table, study_tables
from studies.tables import Table
from studies.tables_page import as_page_table
from studio.pages.shown import Shown
from studio.pages.tables import Image


def show(path: Path) -> Shown:
    """The sweep as it stands. Raises RequestError for a folder that holds none."""
    about = read_about(path)
    if about is None:
        raise RequestError(f"{path / ABOUT} cannot be read. Run the same alula sweep again; it trains nothing twice.")
    outcomes = _outcomes(path)
    results = trained(outcomes)
    tables: tuple[Table, ...] = ()
    if results and about.study == SEARCH:
        tables = (search_table(about.along, outcomes),)
    elif results:
        tables = study_tables(about.study, about.along, outcomes)
    pictures = study_figures(about.study, about.along, results)
    missing = about.count - len(outcomes)
    lines = [*summary_lines(outcomes), *([f"{missing} of {about.count} cells are not trained yet."] if missing else [])]
    return Shown(
        SWEEP,
        f"Sweep: {about.study}",
        lines,
        images=[Image(as_png(figure), caption) for _, figure, caption in pictures],
        tables=[as_page_table(table) for table in tables],
        share=len(outcomes) / about.count if missing > 0 else None,
    )


def _outcomes(path: Path) -> list[Outcome]:
    """The cells that were trained or failed, in the order of their names."""
    outcomes: dict[str, Outcome] = {}
    for file in sorted(path.glob("*.failed")):
        outcomes |= _decoded(file, FailedCell)
    for file in sorted(path.glob("*.json")):
        outcomes |= _decoded(file, CellResult)
    return list(outcomes.values())


def _decoded(file: Path, kind: type[Outcome]) -> dict[str, Outcome]:
    try:
        return {file.stem: decode_json(file.read_bytes(), kind)}
    except (OSError, msgspec.MsgspecError):
        return {}  # another tool's file, or one that is being written
