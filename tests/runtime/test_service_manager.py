"""A service manager hears of the control loop as long as it ticks, and nothing that it does disturbs a flight."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from dynamics.errors import RequestError
from runtime.service_manager import ServiceManager
from tests.support.service_listener import drained


@pytest.fixture(params=["path", "abstract"])
def listening(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[str, socket.socket]]:
    address = str(tmp_path / "notify") if request.param == "path" else f"@{tmp_path}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(address.replace("@", "\0", 1))
        listener.setblocking(False)
        yield address, listener


def test_a_loop_that_hangs_does_not_feed_the_watchdog(listening: tuple[str, socket.socket]) -> None:
    address, listener = listening
    manager = ServiceManager.from_environment({"NOTIFY_SOCKET": address})
    manager.ready()
    for ticks in (0, 10, 20, 20, 20, 31):
        manager.progress(ticks)
    manager.status("ENGAGED:\nthe vehicle is armed")
    manager.stopping()
    manager.close()
    fed = ["WATCHDOG=1"] * 4
    assert drained(listener) == ["READY=1", *fed, "STATUS=ENGAGED: the vehicle is armed", "STOPPING=1"]


def test_without_a_manager_nothing_is_sent() -> None:
    manager = ServiceManager.from_environment({})
    manager.ready()
    manager.progress(1)
    manager.stopping()
    manager.close()


def test_a_manager_that_does_not_read_or_is_gone_costs_nothing(listening: tuple[str, socket.socket]) -> None:
    address, listener = listening
    manager = ServiceManager(address)
    for ticks in range(5000):  # more than a socket holds
        manager.progress(ticks)
    assert 0 < len(drained(listener)) < 5000
    listener.close()
    manager.stopping()
    manager.close()


@pytest.mark.parametrize(("microseconds", "refused"), [("500000", True), ("2000000", False), ("", False)])
def test_a_watchdog_that_would_end_a_healthy_flight_is_refused(microseconds: str, refused: bool) -> None:
    environment = {"NOTIFY_SOCKET": "", "WATCHDOG_USEC": microseconds}
    if refused:
        with pytest.raises(RequestError, match=r"after 0\.5 s .* WatchdogSec=2"):
            ServiceManager.from_environment(environment)
    else:
        ServiceManager.from_environment(environment).close()
