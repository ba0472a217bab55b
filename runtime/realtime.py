"""Real-time scheduling on Linux as far as the operating system permits; a refusal is reported and ends nothing.

Guards keep a defect of ours from taking the machine with it: a process that takes half of the processors goes back to
ordinary scheduling, one that cannot is ended by the kernel, and memory is locked only where enough is left.
"""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

SWITCH_INTERVAL = 5e-4  # s; the interpreter's 5 ms would let a busy thread hold the control thread up for half a tick
MAX_RUN, MAX_SHARE = 2.0, 0.9  # s, and share of half the processors, at least one, that the process may take over it
MAX_RUN_WITHOUT_GUARD = 3.0  # s of processor time without a pause after which the kernel ends the process
MAX_LOCKED = 0.5  # of the available memory
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_LIMITS = "/etc/security/limits.d/alula.conf"
FIFO_REMEDY = (
    f"allow it by a line `USER - rtprio 60` in {_LIMITS} and log in again, or give CAP_SYS_NICE; "
    "--no-realtime does without"
)
MEMORY_REMEDY = f"allow it by a line `USER - memlock unlimited` in {_LIMITS}, or give CAP_IPC_LOCK"
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


def locks_later_memory() -> bool:
    """Whether no limit keeps memory that is asked for later from being locked as well."""
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return os.geteuid() == 0 or limit == resource.RLIM_INFINITY


def _lock_memory() -> None:
    size, available = _memory()
    if size > MAX_LOCKED * available:
        raise ValueError(f"it would take {size / 2**20:.0f} of {available / 2**20:.0f} MiB that are left")
    # under a limit, memory that is asked for later would fail instead of being swapped
    future = _MCL_FUTURE if locks_later_memory() else 0
    library = ctypes.CDLL(None, use_errno=True)
    # pages are locked as they are used: to fill all that is mapped could exceed a container's memory
    if library.mlockall(_MCL_CURRENT | future | _MCL_ONFAULT) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def unlock_memory() -> None:
    """Locked memory may be swapped again."""
    ctypes.CDLL(None).munlockall()


def _memory() -> tuple[int, int]:
    """Resident memory of this process, and the machine's available memory, bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    lines = Path("/proc/meminfo").read_text().splitlines()
    available = next(int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    return pages * resource.getpagesize(), 1024 * available


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
    return _attempt("mlockall", MEMORY_REMEDY, _lock_memory)


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

    return _attempt(f"SCHED_FIFO {priority}", FIFO_REMEDY, raise_all)


def lower_threads() -> None:
    """Put all threads of this process back under ordinary scheduling."""
    for thread in threading.enumerate():
        if thread.native_id is not None:
            with suppress(OSError):  # it has ended meanwhile
                os.sched_setscheduler(thread.native_id, os.SCHED_OTHER, os.sched_param(0))


class Scheduling:
    """Real-time scheduling of this process while it flies; `with Scheduling(50) as scheduling:`.

    On leaving, all threads are under ordinary scheduling.

    priority: of SCHED_FIFO, None for ordinary scheduling.
    refusals: what was refused, each with its remedy.
    """

    def __init__(self, priority: int | None) -> None:
        """priority: to try, 1 to 98; None for ordinary scheduling."""
        self.priority: int | None = None
        self.refusals: list[str] = []
        self._over = threading.Event()
        if priority is None:
            return
        if refusal := _attempt(f"SCHED_FIFO {priority}", FIFO_REMEDY, lambda: _set_fifo(priority)):
            self.refusals.append(refusal)
            return
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        self.priority = priority

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        if self.priority is not None:
            lower_threads()
            unlock_memory()

    def describe(self) -> str:
        """The scheduling in one line."""
        how = f"SCHED_FIFO {self.priority}" if self.priority is not None else "ordinary"
        return "; ".join([how, *self.refusals])

    def raise_all(self, background: int, *, exempt: str) -> None:
        """Lock memory, raise all threads but one to the priority `background`, and guard the processors."""
        if self.priority is None:
            return
        refusals = (lock_memory(), raise_threads(background, exempt=exempt))
        self.refusals += [refusal for refusal in refusals if refusal]
        _, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
        limit = round(1e6 * MAX_RUN_WITHOUT_GUARD)
        if hard == resource.RLIM_INFINITY or hard > limit:
            resource.setrlimit(resource.RLIMIT_RTTIME, (limit, hard))
        threading.Thread(target=self._guard, args=(self.priority + 1,), name="guard", daemon=True).start()

    def _guard(self, priority: int) -> None:
        """Put all threads back when the process takes too much for longer than a flight ever does."""
        schedule_thread(priority)
        limit = MAX_SHARE * MAX_RUN * max(1.0, len(os.sched_getaffinity(0)) / 2)
        before = time.process_time()
        while not self._over.wait(MAX_RUN):
            used, before = time.process_time() - before, time.process_time()
            if used > limit:
                lower_threads()
                self.priority = None
                self.refusals.append(f"given up: {used:.1f} s of processor time were used within {MAX_RUN:g} s")
                return


def schedule_thread(priority: int, processor: int | None = None) -> tuple[str, ...]:
    """Put the calling thread under SCHED_FIFO and on one processor.

    priority: 1 to 99. processor: None for any. Returns what was refused and why.
    """
    refusals = [
        _attempt(
            f"SCHED_FIFO {priority}",
            FIFO_REMEDY,
            lambda: _set_fifo(priority),
        )
    ]
    if processor is not None:
        remedy = f"choose one of {sorted(os.sched_getaffinity(0))}"
        refusals.append(_attempt(f"processor {processor}", remedy, lambda: _set_processor(processor)))
    return tuple(refusal for refusal in refusals if refusal)
