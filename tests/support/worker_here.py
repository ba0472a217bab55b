"""A worker of the studio that does its tasks in the test's own process."""

from __future__ import annotations

from studio.work.steps import StepRunner
from studio.work.task import Task
from studio.work.worker import Outcome


class WorkerHere:
    """Stands for `studio.work.worker.Worker`."""

    def run(self, task: Task, *_: object) -> Outcome:
        """Do a task."""
        StepRunner().do(task, lambda _share, _stage: None)
        return Outcome("done")

    def cancel(self) -> None:
        """Nothing runs beside the test."""

    def close(self) -> None:
        """There is no process."""
