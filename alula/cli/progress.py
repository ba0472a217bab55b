"""Bars of long work: on many items, and in stages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from alula.cli.console import Console
from dynamics import progress as stages


def counting_bar(console: Console) -> Progress:
    """A bar with the number of items that are done, and the last one's name in its field `last`."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[last]}", markup=False),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )


@contextmanager
def stage_bar() -> Iterator[stages.Progress]:
    """A bar on stderr with the stage that runs, which is gone when it ends; none where no terminal would show it."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda share, stage: bar.update(task, completed=share, description=stage)
