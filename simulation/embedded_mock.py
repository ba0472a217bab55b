"""The mock flight controller as a process of ours on a free port, for the demo and for measurements."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from dynamics.errors import VehicleError

STOP_PATIENCE = 5.0  # s


@contextmanager
def embedded_mock(vehicle: str, arguments: Sequence[str] = ()) -> Iterator[str]:
    """Run `alula mock` for a vehicle file; gives the connection string to fly it by.

    Raises VehicleError when it ended by itself before it was told to.
    """
    link, ground = _free_port(), _free_port()
    where = ["--link", f"udpout:127.0.0.1:{link}", "--gcs-link", f"udpout:127.0.0.1:{ground}"]
    command = [sys.executable, "-m", "alula", "mock", "--vehicle", vehicle, *where, *arguments]
    failure: VehicleError | None = None
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield f"udpin:127.0.0.1:{link}"
        except VehicleError as error:
            failure = error  # which may be the mock's own end as seen from the link
        finally:
            ended = process.poll()
            process.terminate()
            try:
                _, said = process.communicate(timeout=STOP_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                _, said = process.communicate()
    if ended is not None:
        raise VehicleError(
            f"the mock ended by itself with exit code {ended}: {said.strip()[-500:] or 'it said nothing'}"
        ) from failure
    if failure is not None:
        raise failure


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
