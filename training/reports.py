"""Reports of members on their progress, and how they reach the process that waits for them.

Without torch, which the process that passes them on would have to load.
"""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.managers import SyncManager

import msgspec

from flights.parallel import end_with_parent, holding_interrupts


class Report(msgspec.Struct, frozen=True):
    """Progress of a member at an evaluation.

    member: its number in the ensemble.
    step: of `steps` in all.
    loss, physics_loss: of the last batch, physics_loss None without one.
    validation: mean squared standardised error.
    best: the lowest validation error up to now.
    learning_rate: at this step.
    """

    member: int
    step: int
    steps: int
    loss: float
    physics_loss: float | None
    validation: float
    best: float
    learning_rate: float


Progress = Callable[[Report], None]


@contextmanager
def progress_channel(progress: Progress) -> Iterator[Progress]:
    """A function that other processes call with their reports: each one reaches `progress` in this process."""
    manager = SyncManager(ctx=multiprocessing.get_context("spawn"))
    with ExitStack() as stack:
        with holding_interrupts():  # one that comes meanwhile is raised after it, when all of this is ended in order
            manager.start(end_with_parent)
            stack.callback(manager.shutdown)
            reports = manager.Queue()

            def forward() -> None:
                while (report := reports.get()) is not None:
                    progress(report)

            thread = threading.Thread(target=forward, name="training progress", daemon=True)
            thread.start()
            stack.callback(thread.join)
            stack.callback(reports.put, None)
        yield reports.put
