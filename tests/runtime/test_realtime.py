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
print("\\n".join(realtime.schedule_thread(50, processor=4000)))
"""


def test_without_privileges_each_refusal_is_named_with_its_remedy() -> None:
    output = subprocess.run([sys.executable, "-c", CHECK], capture_output=True, text=True, check=True).stdout
    assert "mlockall refused" in output
    assert "ulimit -l" in output
    assert "SCHED_FIFO 50 refused" in output
    assert "processor 4000 refused" in output


def test_threads_of_libraries_are_limited_unless_the_user_sets_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    realtime.limit_library_threads()
    assert os.environ["OMP_NUM_THREADS"] == "3"
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
