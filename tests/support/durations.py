"""Seconds of each test of a run with workers, in build/durations.json, so that the slowest are looked up, not guessed.

The file maps a test's name to the seconds of its setup, call and teardown, and lists the tests that failed. It is also
written while tests run: a run that was cut off leaves what it had.
"""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from dynamics.files import write_json

FILE = Path(__file__).parents[2] / "build" / "durations.json"
BETWEEN_WRITES = 30.0  # s
PHASES = ("setup", "call", "teardown")


class Durations:
    """Adds up the phases of each test; the controller of the workers hears of all."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seconds: dict[str, list[float]] = {}
        self._failed: list[str] = []
        self._written = time.monotonic()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add one phase of one test."""
        phases = self._seconds.setdefault(report.nodeid, [0.0] * len(PHASES))
        phases[PHASES.index(report.when)] += report.duration
        if report.failed:
            self._failed.append(report.nodeid)
        if time.monotonic() - self._written > BETWEEN_WRITES:
            self.pytest_sessionfinish()

    def pytest_sessionfinish(self) -> None:
        """Write what was measured so far."""
        self._written = time.monotonic()
        self._path.parent.mkdir(exist_ok=True)
        rounded = {name: [round(phase, 3) for phase in phases] for name, phases in sorted(self._seconds.items())}
        write_json({"failed": self._failed, "phases": PHASES, "seconds": rounded}, self._path)


def pytest_configure(config: pytest.Config) -> None:
    """Listen where workers run the tests, on their controller."""
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Durations(FILE), "durations")
