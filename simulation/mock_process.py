"""The mock flight controller as a child process on free ports, for the demo, measurements and tests."""

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

from dynamics.errors import VehicleError
from vehicles import FOLDER

START_UP = 60.0  # s; the first run compiles the plant
STOP_PATIENCE = 10.0  # s
LAST_LINES = 8  # of its output, in an error


@dataclass
class MockProcess:
    """A running mock.

    port: the companion's UDP port that it sends to.
    gcs_port: the ground station's.
    log: file of what it prints.
    stopped: whether it was ended by `stop`.
    """

    process: subprocess.Popen[bytes]
    port: int
    gcs_port: int
    log: Path
    stopped: bool = False

    @property
    def url(self) -> str:
        """Connection string for whoever listens to the mock."""
        return f"udpin:127.0.0.1:{self.port}"

    def output(self) -> str:
        """Everything it has printed."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def stop(self, number: signal.Signals = signal.SIGTERM) -> int:
        """End it by a signal, or by SIGKILL where that does not end it; returns its exit code."""
        self.stopped = True
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(timeout=STOP_PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    def require_running(self) -> None:
        """Raises VehicleError when the process ended by itself."""
        code = self.process.poll()
        if code is not None and not self.stopped:
            last = "\n".join(self.output().strip().splitlines()[-LAST_LINES:])
            raise VehicleError(f"the mock ended by itself with exit code {code}: {last or 'no output'}")


def free_port() -> int:
    """A UDP port that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def mock_process(*arguments: str, vehicle: str | Path = FOLDER / "px4_sih.toml") -> Iterator[MockProcess]:
    """A mock started with further `alula mock` arguments, ready when its first heartbeat has arrived.

    Raises VehicleError when it ended by itself; an error that followed from that is its cause.
    """
    file = tempfile.NamedTemporaryFile(prefix="mock-", suffix=".log", delete=False)  # noqa: SIM115
    with contextlib.ExitStack() as stack:
        output = stack.enter_context(file)
        stack.callback(Path(file.name).unlink, missing_ok=True)
        listener = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        listener.bind(("127.0.0.1", 0))
        port, gcs_port = int(listener.getsockname()[1]), free_port()
        links = ["--link", f"udpout:127.0.0.1:{port}", "--gcs-link", f"udpout:127.0.0.1:{gcs_port}"]
        command = [sys.executable, "-P", "-m", "alula", "mock", "--vehicle", str(vehicle), *links, *arguments]
        # its input ends with this process, however that ends, and the mock with its input
        command.append("--end-with-input")
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=output, stderr=output, env=dict(os.environ))
        assert process.stdin is not None
        stack.callback(process.stdin.close)
        mock = MockProcess(process, port, gcs_port, Path(file.name))
        stack.callback(mock.stop)
        _await_heartbeat(listener, mock)
        listener.close()  # whoever flies the mock listens there
        try:
            yield mock
        except VehicleError as error:
            try:
                mock.require_running()
            except VehicleError as cause:
                raise cause from error
            raise
        mock.require_running()


def _await_heartbeat(listener: socket.socket, mock: MockProcess) -> None:
    listener.settimeout(0.2)
    deadline = time.monotonic() + START_UP
    while time.monotonic() < deadline:
        mock.require_running()
        with contextlib.suppress(TimeoutError):
            frame = listener.recv(2048)
            if len(frame) > 10 and frame[0] == 0xFD and frame[7:10] == b"\0\0\0":
                return
    raise VehicleError(f"no heartbeat from the mock within {START_UP:g} s:\n{mock.output()}")
