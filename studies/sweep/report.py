"""Outputs of a sweep: summary, tables, pictures, a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
from matplotlib.figure import Figure
from rich.console import Console

from dynamics.errors import DataError
from dynamics.files import write_answer
from studies import figures
from studies.sweep.catalogue import SEARCH
from studies.sweep.cell import CellResult, FailedCell, Outcome, trained
from studies.sweep.figures import study_figures
from studies.sweep.run import Sweep
from studies.sweep.tables import search_table, study_tables
from studies.tables import Table, terminal_table, write_csv
from studies.tables_page import write_tables_page
from training.prediction import pooled


class SweepAnswer(msgspec.Struct, frozen=True):
    """`alula sweep --json`."""

    study: str
    cells: tuple[CellResult, ...]
    failed: tuple[FailedCell, ...]

    @classmethod
    def of(cls, study: str, outcomes: Sequence[Outcome]) -> SweepAnswer:
        """The answer of these outcomes."""
        return cls(study, trained(outcomes), _failures(outcomes))


def tables_of(sweep: Sweep, outcomes: Sequence[Outcome]) -> tuple[Table, ...]:
    """The study's tables."""
    if sweep.study == SEARCH:
        return (search_table(sweep.along, outcomes),)
    return study_tables(sweep.study, sweep.along, outcomes)


def summary_lines(outcomes: Sequence[Outcome]) -> list[str]:
    """The summary in sentences: how many were trained, the best cell, the failures."""
    results, failures = trained(outcomes), _failures(outcomes)
    lines = [f"{len(results)} of {len(outcomes)} trainings are done."]
    if results:
        best = min(results, key=lambda result: pooled(result.best_known).combined)
        errors = pooled(best.best_known)
        words = "the truth" if best.true else "labels"
        lines.append(
            f"Lowest error on the test flights: {best.cell.name}, RMSE {errors.combined:.3g} against {words}, "
            f"{errors.combined / errors.nominal:.3g} of NOM's."
        )
    return [*lines, *(f"failed: {one.cell.name}: {one.message}" for one in failures)]


def require_all_trained(outcomes: Sequence[Outcome]) -> None:
    """Raises DataError when a cell could not be trained."""
    failures = _failures(outcomes)
    if failures:
        raise DataError(
            f"{len(failures)} of {len(outcomes)} trainings failed, {failures[0].cell.name} the first: "
            f"{failures[0].message} What was trained is kept; the same command tries the others again."
        )


def show(
    sweep: Sweep,
    outcomes: Sequence[Outcome],
    console: Console,
    *,
    json_file: Path | None,
    csv: Path | None,
    pictures: Path | None,
    html: Path | None,
) -> None:
    """Print tables and summary, and write the requested files. Raises RequestError for one that cannot be written.

    json_file: - for standard output.
    csv, pictures: folders.
    """
    tables = tables_of(sweep, outcomes)
    for table in tables:
        console.print(terminal_table(table))
    for line in summary_lines(outcomes):
        console.print(line, highlight=False)
    written = [] if csv is None else write_csv(tables, csv)
    if json_file is not None:
        write_answer(SweepAnswer.of(sweep.study, outcomes), json_file)
    if pictures is not None:
        written += draw(sweep, outcomes, pictures)
    if html is not None:
        write_html(sweep, outcomes, html)
        written.append(html)
    for path in written:
        console.print(f"written: {path}", highlight=False)


def draw(sweep: Sweep, outcomes: Sequence[Outcome], folder: Path) -> list[Path]:
    """Write the study's pictures, PNG and PDF; none without a trained cell."""
    written = []
    for name, figure, _ in _figures(sweep, outcomes):
        written += figures.save(figure, folder, name)
    return written


def write_html(sweep: Sweep, outcomes: Sequence[Outcome], path: Path) -> None:
    """Tables and pictures in one file. Raises RequestError when it cannot be written."""
    pictures = [(figure, caption) for _, figure, caption in _figures(sweep, outcomes)]
    title = f"Sweep: {sweep.study}"
    write_tables_page(path, title, summary_lines(outcomes), tables_of(sweep, outcomes), pictures, inputs=sweep.flights)


def _figures(sweep: Sweep, outcomes: Sequence[Outcome]) -> list[tuple[str, Figure, str]]:
    return study_figures(sweep.study, sweep.along, trained(outcomes))


def _failures(outcomes: Sequence[Outcome]) -> tuple[FailedCell, ...]:
    return tuple(outcome for outcome in outcomes if isinstance(outcome, FailedCell))
