"""One worker of a test run keeps the tests that fly against the clock; the others compute beside it, behind it.

Files with a test marked `realtime` go to the first worker, before all others; the other workers take the other files,
at a nice value that leaves a flight the processor whenever it wants it. A flight waits for its clock more than half
of its time, which is theirs. There is one worker more than processors for that reason.
"""

from __future__ import annotations

import os
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

FIRST = "gw0"
BEHIND = 10  # nice value of the other workers, a tenth of the first one's share where both want a processor
MARKED = re.compile(r"^\s*(@|pytestmark = )pytest\.mark\.realtime\s*$", re.MULTILINE)


class ClockScheduling(LoadFileScheduling):
    """Hands out files in their order, those against the clock to one worker only, which begins with them."""

    def _assign_work_unit(self, node: WorkerController) -> None:
        """Assign a file to a worker, or let the worker go where none is left for it."""
        alive = [worker for worker in self.nodes if not worker.shutting_down]
        keeper = min(alive, key=lambda worker: worker.gateway.id != FIRST, default=node)
        marked = {scope: against_the_clock(self.config.rootpath / scope) for scope in self.workqueue}
        kind = node is keeper and True in marked.values()
        chosen = next((scope for scope, clocked in marked.items() if clocked == kind), None)
        if chosen is None:
            node.shutdown()
            return
        self.workqueue.move_to_end(chosen, last=False)
        super()._assign_work_unit(node)


@cache
def against_the_clock(path: Path) -> bool:
    """Whether a file has tests that fly against the clock; `realtime(repeats_only=True)` marks none."""
    return MARKED.search(path.read_text()) is not None


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ClockScheduling:
    """Schedule with one worker for the clock; called by pytest-xdist in the process that starts the workers."""
    return ClockScheduling(config, log)


def pytest_xdist_auto_num_workers() -> int:
    """One worker more than processors, four at most."""
    return min(len(os.sched_getaffinity(0)) + 1, 4)


def pytest_configure(config: pytest.Config) -> None:
    """Put a worker that computes behind the one that keeps the clock; a run inside of a test is no worker of ours."""
    if getattr(config, "workerinput", {}).get("workerid", FIRST) != FIRST:
        os.nice(BEHIND)
