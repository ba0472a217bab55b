"""Every refusal of the operating system is reported with a remedy, and none ends the flight."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from runtime import realtime

CHECK = """
import resource, sys
from runtime import realtime
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
import os
if os.getuid() == 0:
    os.setgid(65534); os.setuid(65534)
print(realtime.lock_memory())
with realtime.Scheduling(50) as scheduling:
    assert scheduling.priority is None
    print(scheduling.describe())
print("\\n".join(realtime.schedule_thread(50, processor=4000)))
"""


def test_without_privileges_each_refusal_is_named_with_its_remedy() -> None:
    output = subprocess.run([sys.executable, "-c", CHECK], capture_output=True, text=True, check=True).stdout
    assert "mlockall refused" in output
    assert "memlock" in output
    assert "rtprio" in output
    assert "SCHED_FIFO 50 refused" in output
    assert "processor 4000 refused" in output


def is_permitted() -> bool:
    with realtime.Scheduling(1) as scheduling:
        return scheduling.priority is not None


RUNAWAY = """
import os, threading, time
from runtime import realtime
realtime.MAX_RUN, realtime.MAX_SHARE = 0.4, 0.9 / max(1.0, len(os.sched_getaffinity(0)) / 2)
def run():
    while os.sched_getscheduler(0) == os.SCHED_FIFO:
        sum(range(1000))
with realtime.Scheduling(20) as scheduling:
    scheduling.raise_all(1, exempt="none")
    assert os.sched_getscheduler(0) == os.SCHED_FIFO
    thread = threading.Thread(target=run)
    thread.start()
    thread.join(20.0)
    print(thread.is_alive(), scheduling.describe())
"""


@pytest.mark.skipif(not is_permitted(), reason="this machine permits no real-time scheduling")
def test_a_real_time_thread_that_never_pauses_is_put_back_under_ordinary_scheduling() -> None:
    command = [sys.executable, "-c", RUNAWAY]
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    assert output.startswith("False ordinary; given up: 0."), output


@pytest.mark.skipif(not is_permitted(), reason="this machine permits no real-time scheduling")
def test_afterwards_all_threads_are_ordinary_ones() -> None:
    with realtime.Scheduling(20) as scheduling:
        scheduling.raise_all(1, exempt="none")
        assert scheduling.describe().startswith("SCHED_FIFO 20")
        assert os.sched_getscheduler(0) == os.SCHED_FIFO
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_memory_is_not_locked_where_little_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "_memory", lambda: (600 * 2**20, 1000 * 2**20))
    assert "600 of 1000 MiB" in realtime.lock_memory()


def test_without_a_request_nothing_is_tried() -> None:
    with realtime.Scheduling(None) as scheduling:
        scheduling.raise_all(1, exempt="none")
        assert (scheduling.priority, scheduling.describe()) == (None, "ordinary")


def test_threads_of_libraries_are_limited_unless_the_user_sets_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    realtime.limit_library_threads()
    assert os.environ["OMP_NUM_THREADS"] == "3"
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
