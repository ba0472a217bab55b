"""Signals while a vehicle flies: whatever would end or stop the process lands the vehicle instead."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

STOPPING = (signal.SIGINT, signal.SIGTERM)  # given twice, they stop the stream at once
# all others that end or stop a process unless it handles them, but a crash of its own code and what cannot be handled
OTHERS = tuple(
    getattr(signal, name)
    for name in (
        "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGVTALRM", "SIGPROF", "SIGXCPU", "SIGXFSZ",
        "SIGIO", "SIGPWR", "SIGSTKFLT",
    )
    if hasattr(signal, name)
)  # fmt: skip
TERMINAL = (signal.SIGTTIN, signal.SIGTTOU)  # a terminal that another job has must not stop the process


@contextmanager
def landing_on_signals(interrupt: Callable[[str], None]) -> Iterator[None]:
    """Inside, signals call interrupt with their name. No effect outside of the main thread.

    A signal that the program handles or ignores already, such as SIGHUP under nohup, stays as it is.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: set[int] = set()

    def handle(number: int, frame: FrameType | None) -> None:
        if number in STOPPING or not received:  # a closing terminal sends SIGHUP several times
            received.add(number)
            interrupt(signal.Signals(number).name)

    others = [number for number in OTHERS if signal.getsignal(number) is signal.SIG_DFL]
    before = {number: signal.signal(number, handle) for number in (*STOPPING, *others)}
    before |= {number: signal.signal(number, signal.SIG_IGN) for number in TERMINAL}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
