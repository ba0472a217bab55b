"""The mock's process ends with the program that started it."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.deadline import wait_until

pytestmark = pytest.mark.realtime(repeats_only=True)

STARTER = """
import time
from simulation.mock_process import mock_process
with mock_process() as mock:
    print(mock.process.pid, flush=True)
    time.sleep(600)
"""


def is_running(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_program_that_is_killed_takes_its_mock_with_it(number: signal.Signals) -> None:
    with subprocess.Popen([sys.executable, "-c", STARTER], stdout=subprocess.PIPE, text=True) as starter:
        assert starter.stdout is not None
        mock = int(starter.stdout.readline())
        assert is_running(mock)
        starter.send_signal(number)
    wait_until(lambda: not is_running(mock))
