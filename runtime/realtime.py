"""Real-time scheduling on Linux, as far as the operating system permits; what it refuses is told and lived without."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import threading
from collections.abc import Callable

SWITCH_INTERVAL = 5e-4  # s; the interpreter's 5 ms would let a busy thread hold the control thread up for half a tick
_MCL_CURRENT_AND_FUTURE = 3
LIBRARY_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def limit_library_threads() -> None:
    """Make numerical libraries use one thread each; has effect on those that are loaded afterwards."""
    for name in LIBRARY_THREADS:
        os.environ.setdefault(name, "1")


def prepare_interpreter() -> None:
    """Let threads take turns often and keep what exists now out of the garbage collector's way."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.collect()
    gc.freeze()


def _lock_memory() -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_MCL_CURRENT_AND_FUTURE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _be_scheduled_first(priority: int) -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def _stay_on(processor: int) -> None:
    os.sched_setaffinity(0, {processor})


def _attempt(what: str, remedy: str, action: Callable[[], None]) -> str:
    try:
        action()
    except (OSError, AttributeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        return f"{what} refused: {reason} ({remedy})"
    return ""


def lock_memory() -> str:
    """Keep the whole process in memory. Returns why that was refused, empty when it was not."""
    return _attempt("mlockall", "raise `ulimit -l` or give CAP_IPC_LOCK", _lock_memory)


def raise_threads(priority: int, *, besides: str) -> str:
    """Run all threads of this process but one, and those started from here later, ahead of other processes.

    An ordinary thread that holds the interpreter's lock while it waits for the processor would hold a real-time one
    up. besides: name of the thread that keeps its own priority. Returns why it was refused, empty when it was not.
    """

    def raise_all() -> None:
        for thread in threading.enumerate():
            if thread.native_id is not None and thread.name != besides:
                os.sched_setscheduler(thread.native_id, os.SCHED_FIFO, os.sched_param(priority))

    return _attempt(f"SCHED_FIFO {priority}", "raise `ulimit -r` or give CAP_SYS_NICE", raise_all)


def lower_thread() -> None:
    """Run the calling thread as ordinary ones are."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def schedule_thread(priority: int, processor: int | None = None) -> tuple[str, ...]:
    """Run the calling thread under SCHED_FIFO and, if given, on one processor. Returns what was refused and why.

    priority: 1 to 99.
    """
    refusals = [
        _attempt(
            f"SCHED_FIFO {priority}",
            "raise `ulimit -r` or give CAP_SYS_NICE",
            lambda: _be_scheduled_first(priority),
        )
    ]
    if processor is not None:
        remedy = f"choose one of {sorted(os.sched_getaffinity(0))}"
        refusals.append(_attempt(f"processor {processor}", remedy, lambda: _stay_on(processor)))
    return tuple(refusal for refusal in refusals if refusal)
