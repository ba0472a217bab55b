"""Real-time scheduling on Linux as far as the operating system permits; a refusal is reported and ends nothing."""

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
    """Make numerical libraries use one thread each; affects those that are loaded afterwards."""
    for name in LIBRARY_THREADS:
        os.environ.setdefault(name, "1")


def prepare_interpreter() -> None:
    """Switch between threads often, and exempt the present objects from garbage collection."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.collect()
    gc.freeze()


def _lock_memory() -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_MCL_CURRENT_AND_FUTURE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _set_fifo(priority: int) -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def _set_processor(processor: int) -> None:
    os.sched_setaffinity(0, {processor})


def _attempt(what: str, remedy: str, action: Callable[[], None]) -> str:
    try:
        action()
    except (OSError, AttributeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        return f"{what} refused: {reason} ({remedy})"
    return ""


def lock_memory() -> str:
    """Lock the whole process into memory. Returns why that was refused, empty when it was not."""
    return _attempt("mlockall", "raise `ulimit -l` or give CAP_IPC_LOCK", _lock_memory)


def raise_threads(priority: int, *, exempt: str) -> str:
    """Put all threads of this process but one, and those started from here later, under SCHED_FIFO.

    An ordinary thread that holds the interpreter's lock while it waits for the processor would delay a real-time one.

    priority: 1 to 99.
    exempt: name of the thread that keeps its own priority.
    Returns why it was refused, empty when it was not.
    """

    def raise_all() -> None:
        for thread in threading.enumerate():
            if thread.native_id is not None and thread.name != exempt:
                os.sched_setscheduler(thread.native_id, os.SCHED_FIFO, os.sched_param(priority))

    return _attempt(f"SCHED_FIFO {priority}", "raise `ulimit -r` or give CAP_SYS_NICE", raise_all)


def lower_thread() -> None:
    """Put the calling thread back under ordinary scheduling."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def schedule_thread(priority: int, processor: int | None = None) -> tuple[str, ...]:
    """Put the calling thread under SCHED_FIFO and on one processor.

    priority: 1 to 99. processor: None for any. Returns what was refused and why.
    """
    refusals = [
        _attempt(
            f"SCHED_FIFO {priority}",
            "raise `ulimit -r` or give CAP_SYS_NICE",
            lambda: _set_fifo(priority),
        )
    ]
    if processor is not None:
        remedy = f"choose one of {sorted(os.sched_getaffinity(0))}"
        refusals.append(_attempt(f"processor {processor}", remedy, lambda: _set_processor(processor)))
    return tuple(refusal for refusal in refusals if refusal)
