"""A process that works on a case: one task at a time, with progress, and it can be ended at any moment.

A task's result is a folder that appears whole. What a task leaves in memory (logs, data set, diagnosis) serves the next
one; a worker that is ended or has done many tasks is replaced by a fresh one, so that memory stays bounded.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Literal

from dynamics.approvals import Kind
from dynamics.errors import AlulaError
from dynamics.trust import approve_here, approved_here
from flights.parallel import end_with_parent, holding_interrupts
from studio.work.task import Task

MAX_TASKS = 40  # of one process: CasADi's functions are never given back to the system
MEMORY_SHARE = 0.6  # of the computer's memory that a worker may take
NICENESS = 5  # the page answers first

Message = tuple[Literal["progress"], float, str] | tuple[Literal["done", "refused", "failed"], str]


@dataclass(frozen=True)
class Outcome:
    """How a task ended. text: of an error."""

    kind: Literal["done", "refused", "failed", "cancelled"]
    text: str = ""


class Worker:
    """A worker process and the conversation with it. memory: bytes that it may take, by default a share of all."""

    def __init__(self, memory: int | None = None) -> None:
        self.memory = memory or int(MEMORY_SHARE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
        self._lock = threading.Lock()
        self._cancelled = False
        self._tasks = 0
        self._start()

    def run(self, task: Task, progress: Callable[[float, str], None]) -> Outcome:
        """Do a task. Waits until it has ended; another thread may cancel it."""
        with self._lock:
            self._cancelled = False
            if self._tasks >= MAX_TASKS or not self._process.is_alive():
                self._replace()
            self._tasks += 1
            connection = self._connection
            connection.send(task)
        try:
            while True:
                message: Message = connection.recv()
                if message[0] == "progress":
                    progress(message[1], message[2])
                    continue
                return Outcome(message[0], message[1])
        except (EOFError, OSError):
            return self._ended()

    def cancel(self) -> None:
        """End the task that runs, if any; the process that held its data goes too."""
        with self._lock:
            self._cancelled = True
            self._replace()

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._cancelled = True
            self._end()

    def _ended(self) -> Outcome:
        """The outcome of a task whose process is gone."""
        with self._lock:
            if self._cancelled:
                return Outcome("cancelled")
            self._process.join(timeout=1.0)
            code = self._process.exitcode
            self._replace()
        advice = (
            f"It may take {self.memory / 2**30:.1f} GB (`alula studio --memory`). The next step starts a new process."
        )
        return Outcome("failed", f"the worker process died (exit code {code}). {advice}")

    def _start(self) -> None:
        # spawned rather than forked: the server's threads may hold locks
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(
            target=serve, args=(theirs, self.memory, approved_here()), daemon=True, name="alula studio worker"
        )
        with holding_interrupts():
            self._process.start()
        theirs.close()
        self._tasks = 0

    def _end(self) -> None:
        self._process.kill()
        self._process.join()
        self._connection.close()

    def _replace(self) -> None:
        self._end()
        self._start()


def serve(connection: Connection, memory: int, approved: tuple[tuple[Kind, str], ...] = ()) -> None:
    """The loop of a worker process. approved: what may run here, as in the process that started it."""
    end_with_parent()
    approve_here(approved)
    os.nice(NICENESS)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    resource.setrlimit(resource.RLIMIT_DATA, (memory, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    import scipy.signal  # it and the libraries of the workbench, before the first task asks for them
    import scipy.stats  # noqa: F401

    from studio.work.steps import StepRunner

    runner = StepRunner()
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        try:
            runner.do(task, lambda share, stage: connection.send(("progress", share, stage)))
        except AlulaError as error:
            connection.send(("refused", str(error)))
        except MemoryError:
            connection.send(("failed", _out_of_memory(memory)))
            return  # what is left of it is not to be trusted
        except Exception as error:
            traceback.print_exc()
            connection.send(("failed", f"{type(error).__name__}: {error}"))
        else:
            connection.send(("done", ""))


def _out_of_memory(memory: int) -> str:
    advice = "Give fewer or shorter logs, or more memory with `alula studio --memory`."
    return f"the working process may take {memory / 2**30:.1f} GB, and these logs need more. {advice}"
