"""The supervisor feeds systemd's watchdog while ticks finish: not longer, and not past the end of the control loop."""

from __future__ import annotations

import configparser
import queue
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from runtime.control_thread import Requests
from runtime.service_manager import MIN_WATCHDOG, ServiceManager
from runtime.setpoint_stream import SetpointStream
from runtime.supervisor import LANDING_PATIENCE, Supervisor
from tests.support.pages import ROOT
from tests.support.service_listener import drained

UNIT = ROOT / "examples" / "deploy" / "alula-fly.service"


class ScriptedControl:
    """A control thread whose finished ticks a test lists, one number for each look of the supervisor."""

    def __init__(self, ticks: list[int]) -> None:
        self.ticks = 0
        self.stream = SetpointStream(None, lambda record, time: None)  # type: ignore[arg-type]
        self.notifications: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._script = iter(ticks)

    def join(self, timeout: float) -> bool:
        """End once the list does."""
        self.ticks = next(self._script, -1)
        return self.ticks < 0


class SlowWorker:
    """A request worker whose last request nobody answers."""

    refusal = ""

    def __init__(self, heard: list[str], listener: socket.socket) -> None:
        self._heard, self._listener = heard, listener
        self.before_join: list[str] = []

    def join(self, timeout: float) -> bool:
        """Note what the service manager had heard when the wait began."""
        self._heard += drained(self._listener)
        self.before_join = list(self._heard)
        return False


@pytest.fixture
def listener(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as made:
        made.bind(str(tmp_path / "notify"))
        made.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield made


def supervise(ticks: list[int], listener: socket.socket, monkeypatch: pytest.MonkeyPatch) -> SlowWorker:
    """Run the supervisor's loop over a scripted control thread; all else that it does is left out."""
    worker, service, unused = SlowWorker([], listener), ServiceManager.from_environment(), Mock()
    supervisor = Supervisor(
        unused,
        ScriptedControl(ticks),  # type: ignore[arg-type]
        worker,  # type: ignore[arg-type]
        unused,
        Requests(),
        slow_checks=lambda now: {},
        streams=unused,
        feed=unused,
        scheduling=unused,
        announcements=unused,
        service=service,
        timeout=10.0,
    )
    for name in ("_await_readiness", "_remind_pilot"):
        monkeypatch.setattr(supervisor, name, lambda now: None)
    supervisor.serve()
    service.close()
    return worker


def test_ticks_that_stop_in_a_living_process_stop_the_feeding(
    listener: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker = supervise([10, 20, 30, *[30] * 40], listener, monkeypatch)
    assert worker.before_join.count("WATCHDOG=1") == 3


def test_the_watchdog_is_told_of_the_end_before_the_last_request_is_waited_for(
    listener: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker = supervise([10, 20], listener, monkeypatch)
    assert worker.before_join == ["WATCHDOG=1", "WATCHDOG=1", "STOPPING=1"]


def test_the_unit_of_the_examples_suits_the_daemon() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read_string(UNIT.read_text(encoding="utf-8").replace("\\\n", " "))
    service = unit["Service"]
    assert (service["Type"], service["NotifyAccess"], service["KillSignal"]) == ("notify", "main", "SIGTERM")
    assert float(service["WatchdogSec"]) >= MIN_WATCHDOG
    assert service["WatchdogSignal"] == "SIGKILL"  # a hung process must not resume the stream
    assert service["Restart"] == "no"  # a restarted flight would take off again
    assert float(service["TimeoutStopSec"]) > LANDING_PATIENCE
    assert "Install" not in unit
