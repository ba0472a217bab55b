"""How long the host kept this process and its children off the processors, from the kernel's own accounts.

A thread that is ready to run but waits counts in `/proc/PID/task/TID/schedstat`; time that a hypervisor gives to
others counts as stolen in `/proc/stat`. Waiting alone is no proof: threads of ours may be in each other's way, and a
defect may make them so. It counts as the host's doing only while programs outside of our process tree run as well.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

WINDOW = 0.2  # s between two readings of the accounts
MIN_WAIT = 0.01  # s in a window: a control tick, from which on a flight shows it
MIN_OTHERS = 0.25  # processors that other programs take in a window, below which a wait is our own doing
TICK = 1.0 / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Window:
    """The accounts of one window.

    start, end: monotonic time, s.
    wait: longest time that one of our threads waited for a processor, s.
    others: processors that programs outside of our process tree took, mean over the window.
    stolen: time that the hypervisor gave to others, s, all processors together.
    """

    start: float
    end: float
    wait: float
    others: float
    stolen: float

    @property
    def lost(self) -> float:
        """Time that the host withheld in this window, s; 0 where none of it was the host's doing."""
        wait = self.wait if self.wait >= MIN_WAIT and self.others >= MIN_OTHERS else 0.0
        return max(wait, self.stolen if self.stolen >= MIN_WAIT else 0.0)


@dataclass(frozen=True, slots=True)
class Starvation:
    """Processor time that the host withheld over a time.

    lost: sum over the windows, s.
    longest: most in one window, s.
    others: processors that other programs took in the worst window.
    duration: time that was watched, s.
    """

    lost: float = 0.0
    longest: float = 0.0
    others: float = 0.0
    duration: float = 0.0

    @property
    def is_starved(self) -> bool:
        """Whether a test against the clock may have failed for it."""
        return self.lost > 0.0

    def __str__(self) -> str:
        return (
            f"in {self.duration:.1f} s our threads waited {self.lost:.2f} s for a processor, up to "
            f"{self.longest * 1e3:.0f} ms at a time, while other programs took up to {self.others:.1f} of "
            f"{os.cpu_count()} processors"
        )


def starvation_of(windows: list[Window]) -> Starvation:
    """The sum of some windows."""
    if not windows:
        return Starvation()
    worst = max(windows, key=lambda window: window.lost)
    return Starvation(
        lost=sum(window.lost for window in windows),
        longest=worst.lost,
        others=worst.others,
        duration=windows[-1].end - windows[0].start,
    )


@dataclass(frozen=True, slots=True)
class Accounts:
    """One reading of the kernel's accounts.

    threads: time run and time waited, s, of every thread of our process tree by its id.
    busy, stolen: of all processors since boot, s.
    """

    time: float
    threads: dict[int, tuple[float, float]]
    busy: float
    stolen: float

    def since(self, before: Accounts) -> Window:
        """Change between two readings; a thread that is new in this one has all its time counted."""
        run = wait = 0.0
        for thread, (ran, waited) in self.threads.items():
            ran_before, waited_before = before.threads.get(thread, (0.0, 0.0))
            run += ran - ran_before
            wait = max(wait, waited - waited_before)
        elapsed = max(self.time - before.time, 1e-3)
        others = max(0.0, self.busy - before.busy - run) / elapsed
        return Window(before.time, self.time, wait, others, self.stolen - before.stolen)


def read_accounts(own_threads: frozenset[int] = frozenset()) -> Accounts:
    """The accounts of now. own_threads: ids of threads to leave out, such as the meter's."""
    threads = {}
    for folder in _threads(os.getpid()):
        try:
            ran, waited, _ = (folder / "schedstat").read_text().split()
        except (OSError, ValueError):
            continue  # it has ended, or this kernel keeps no such account
        if int(folder.name) not in own_threads:
            threads[int(folder.name)] = (int(ran) * 1e-9, int(waited) * 1e-9)
    user, nice, system, _, _, interrupt, soft, stolen, *_ = (
        int(count) * TICK for count in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
    )
    return Accounts(time.monotonic(), threads, user + nice + system + interrupt + soft, stolen)


def _threads(process: int) -> Iterator[Path]:
    """The folders of all threads of a process and of its descendants."""
    try:
        folders = list(Path(f"/proc/{process}/task").iterdir())
    except OSError:
        return
    for folder in folders:
        yield folder
        try:
            children = (folder / "children").read_text().split()
        except OSError:
            continue
        for child in children:
            yield from _threads(int(child))


class StarvationMeter:
    """Reads the accounts in a thread of its own from start to stop."""

    def __init__(self) -> None:
        self.windows: list[Window] = []
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._last: Accounts | None = None
        self._reading = threading.Lock()

    @property
    def is_running(self) -> bool:
        """Whether windows are being added."""
        return self._thread is not None

    def start(self) -> None:
        """Begin to watch, if it has not begun."""
        if self._thread is not None or not Path("/proc/self/schedstat").exists():
            return
        self._ending.clear()
        self._last = None
        self._thread = threading.Thread(target=self._watch, name="starvation meter", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop watching; what was measured stays."""
        if self._thread is not None:
            self._ending.set()
            self._thread.join()
            self._thread = None

    def since(self, start: float) -> Starvation:
        """Time that was withheld from a time (monotonic, s) until now."""
        if self.is_running:
            self._read()
        return starvation_of([window for window in self.windows if window.end > start])

    def _watch(self) -> None:
        self._read()
        while not self._ending.wait(WINDOW):
            self._read()

    def _read(self) -> None:
        with self._reading:
            meter = self._thread.native_id if self._thread is not None else None
            accounts = read_accounts(frozenset({meter} if meter is not None else ()))
            if self._last is not None:
                self.windows.append(accounts.since(self._last))
            self._last = accounts
