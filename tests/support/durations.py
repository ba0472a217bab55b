"""Seconds of each test of a run with workers, in build/durations.json, so that the slowest are looked up, not guessed.

The file maps a test's name to the seconds of its setup, call and teardown, and lists the tests that failed. It is also
written while tests run: a run that was cut off leaves what it had. A test of more than 20 s gives its reason as
`@pytest.mark.long("...")`; the end of a run lists those that give none.
"""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from dynamics.files import write_json

FILE = Path(__file__).parents[2] / "build" / "durations.json"
BETWEEN_WRITES = 30.0  # s
LONG = 20.0  # s of a test that needs a reason
PHASES = ("setup", "call", "teardown")


class Durations:
    """Adds up the phases of each test; the controller of the workers hears of all."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seconds: dict[str, list[float]] = {}
        self._failed: list[str] = []
        self._reasons: set[str] = set()  # tests that say why they take long
        self._written = time.monotonic()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add one phase of one test."""
        phases = self._seconds.setdefault(report.nodeid, [0.0] * len(PHASES))
        if report.when in PHASES:  # none where the test's process was killed
            phases[PHASES.index(report.when)] += report.duration
        if "long" in dict(report.user_properties):
            self._reasons.add(report.nodeid)
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

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """List the long tests without a reason."""
        totals = {name: sum(phases) for name, phases in self._seconds.items() if name not in self._reasons}
        unexplained = sorted((name for name, total in totals.items() if total > LONG), key=lambda name: -totals[name])
        if unexplained:
            terminalreporter.section(f"more than {LONG:g} s, and no reason beside it")
            for name in unexplained:
                terminalreporter.line(f"{totals[name]:.0f} s {name}")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Send a test's reason along with its reports."""
    for marker in item.iter_markers("long"):
        item.user_properties.append(("long", marker.args[0]))


def pytest_configure(config: pytest.Config) -> None:
    """Listen where workers run the tests, on their controller."""
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Durations(FILE), "durations")
