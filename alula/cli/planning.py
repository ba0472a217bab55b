"""The bar while an identification flight is planned, or lines where no terminal would show one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from alula.cli.console import Console

STARTING = "planning an identification flight"


@contextmanager
def planning_progress(console: Console) -> Iterator[Callable[[str, float], None]]:
    """A bar, as what `alula.plan_flight` calls with what is done and its share; lines where there is no terminal."""
    if not console.is_terminal:
        yield _lines(console)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, refresh_per_second=4) as bar:
        task = bar.add_task(STARTING, total=None)

        def report(what: str, share: float) -> None:
            # the flight on the mock has no share: its bar moves to and fro
            bar.update(task, description=what, completed=share, total=1.0 if share else None)

        yield report


def _lines(console: Console) -> Callable[[str, float], None]:
    """A line at the start, at every tenth of a stage and at a stage without shares."""
    printed = {STARTING: 0}
    console.print(STARTING, highlight=False)

    def report(what: str, share: float) -> None:
        tenths = int(10 * share + 1e-9)
        if printed.get(what) != tenths:
            printed[what] = tenths
            console.print(f"{what}: {10 * tenths} %" if share else what, highlight=False)

    return report
