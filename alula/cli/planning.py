"""The bar while an identification flight is planned."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn


@contextmanager
def planning_progress(console: Console) -> Iterator[Callable[[str, float], None]]:
    """A bar, as what `alula.plan_flight` calls with what is done and its share."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, refresh_per_second=4) as bar:
        task = bar.add_task("planning", total=None, visible=False)

        def report(what: str, share: float) -> None:
            # the flight on the mock has no share: its bar moves to and fro
            bar.update(task, description=what, completed=share, total=1.0 if share else None, visible=True)

        yield report
