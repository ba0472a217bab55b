"""The mock as a process for tests: on free ports, ready when its first heartbeat is heard."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from vehicles import FOLDER

START_UP = 60.0  # s; the first run compiles the plant


@dataclass
class MockProcess:
    """A running mock. port: the companion's UDP port that it sends to (listen there, udpin:127.0.0.1:port)."""

    process: subprocess.Popen[bytes]
    port: int
    gcs_port: int
    log: Path

    @property
    def url(self) -> str:
        """Connection string for whoever listens to the mock."""
        return f"udpin:127.0.0.1:{self.port}"

    def output(self) -> str:
        """What it has printed."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def stop(self, number: signal.Signals = signal.SIGTERM) -> int:
        """End it by a signal; returns its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(timeout=10)


def free_port() -> int:
    """A UDP port that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def mock_process(*arguments: str, vehicle: Path = FOLDER / "px4_sih.toml") -> Iterator[MockProcess]:
    """A mock started with further `alula mock` arguments, ready when its first heartbeat has been heard."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(0.2)
        port, gcs_port = int(ear.getsockname()[1]), free_port()
        log = Path(tempfile.mkstemp(prefix="mock-", suffix=".log")[1])
        links = ["--link", f"udpout:127.0.0.1:{port}", "--gcs-link", f"udpout:127.0.0.1:{gcs_port}"]
        command = [sys.executable, "-m", "alula.cli", "mock", "--vehicle", str(vehicle), *links, *arguments]
        with log.open("wb") as output:
            process = subprocess.Popen(command, stdout=output, stderr=output, env=dict(os.environ))
        mock = MockProcess(process, port, gcs_port, log)
        try:
            _await_heartbeat(ear, mock)
        except BaseException:
            process.kill()
            process.wait()
            raise
    try:
        yield mock
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        log.unlink(missing_ok=True)


def _await_heartbeat(ear: socket.socket, mock: MockProcess) -> None:
    deadline = time.monotonic() + START_UP
    while time.monotonic() < deadline:
        if mock.process.poll() is not None:
            raise RuntimeError(f"the mock ended with {mock.process.returncode}:\n{mock.output()}")
        with contextlib.suppress(TimeoutError):
            frame = ear.recv(2048)
            if len(frame) > 10 and frame[0] == 0xFD and frame[7:10] == b"\0\0\0":
                return
    raise RuntimeError(f"no heartbeat from the mock within {START_UP} s:\n{mock.output()}")
