"""How many processes the cases of a server have."""

from __future__ import annotations

import time
from pathlib import Path
from typing import ClassVar

import pytest

from studies.results.read import RESULTS
from studio.app import studio as room
from studio.app.studio import MAX_WORKERS, Studio
from studio.work.worker import Outcome

MEMORY = 123_456_789  # bytes: by which this test's server is known from those whose timers other tests left


class CountedWorker:
    """A worker without a process; those of other servers do not count."""

    alive: ClassVar[set[CountedWorker]] = set()  # threads add and remove at once

    def __init__(self, memory: int | None = None) -> None:
        if memory == MEMORY:
            self.alive.add(self)

    def run(self, *_: object) -> Outcome:
        return Outcome("cancelled")

    def cancel(self) -> None:
        """Nothing runs."""

    def close(self) -> None:
        self.alive.discard(self)


def test_processes_of_cases_that_rest_end_and_one_waits_for_the_next(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(room, "Worker", CountedWorker)
    monkeypatch.setattr(room, "SPARE_DELAY", 0.0)
    log = tmp_path / "log.csv"
    log.write_text("t\n1\n")
    server = Studio(tmp_path / "cases", RESULTS, memory=MEMORY)
    for _ in range(5):
        opened = server.case(server.create(name="case"))
        assert opened is not None
        opened.case.add_logs([log])
        opened.start("check")
        opened.wait(10.0)
        deadline = time.monotonic() + 10.0
        while server._spare is None and time.monotonic() < deadline:
            time.sleep(0.01)
        assert len(CountedWorker.alive) <= MAX_WORKERS + 1
    server.close()
    assert not CountedWorker.alive
