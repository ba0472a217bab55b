"""`@pytest.mark.realtime`: a test that flies against the clock repeats itself when the host starved it.

The first attempt is like any test. If it fails, and the kernel's accounts show that other programs kept our threads
or those of the mock waiting since the fixtures of its module were made, then it says nothing about us: all fixtures
below the session are made anew and the test runs again, now ahead of the other programs where we may raise our
priority. A failure without starvation counts at once. A failure in every attempt counts too, with what was measured:
a defect fails under load as well, and a test that never got its processor time has shown nothing that could pass.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import call_and_report

from simulation.starvation import MIN_OTHERS, Starvation, StarvationMeter, read_accounts

MAX_ATTEMPTS = 4
QUIET_PATIENCE = 5.0  # s to wait before a repetition for the other programs to end
REPEAT_PRIORITY = -10  # nice value of a repetition

Report = Any


class RealtimePlugin:
    """Runs the marked tests and tells at the end which of them were repeated."""

    def __init__(self, meter: StarvationMeter | None = None, *, quiet_patience: float = QUIET_PATIENCE) -> None:
        self.meter = meter or StarvationMeter()
        self._quiet_patience = quiet_patience
        self.repeated: list[str] = []
        self._fresh_since: dict[str, float] = {}

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
        """Run a marked test, up to `MAX_ATTEMPTS` times."""
        if item.get_closest_marker("realtime") is None:
            return None
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        self.meter.start()
        for report in self._reports(item, nextitem):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        if nextitem is None or nextitem.get_closest_marker("realtime") is None:
            self.meter.stop()
        return True

    def _reports(self, item: pytest.Item, nextitem: pytest.Item | None) -> list[Report]:
        """The reports of the attempt that counts."""
        module = item.nodeid.split("::")[0]
        self._fresh_since.setdefault(module, time.monotonic())
        reports, starvation = self._attempt(item, nextitem, self._fresh_since[module], is_last=False)
        for attempt in range(2, MAX_ATTEMPTS + 1):
            if not _repeats(reports, starvation):
                return reports
            self.repeated.append(f"{item.nodeid} (attempt {attempt}): {starvation}")
            _wait_until_quiet(self._quiet_patience)
            self._fresh_since[module] = time.monotonic()
            with _ahead_of_others(), _timeout_of_its_own(item):
                reports, starvation = self._attempt(
                    item, nextitem, self._fresh_since[module], is_last=attempt == MAX_ATTEMPTS
                )
        if _repeats(reports, starvation):
            _mark_as_starved(reports, starvation)
        return reports

    def _attempt(
        self, item: pytest.Item, nextitem: pytest.Item | None, since: float, *, is_last: bool
    ) -> tuple[list[Report], Starvation]:
        """Set up, call, tear down; all but the session's fixtures are torn down where a repetition follows."""
        if not getattr(item, "_request", True):
            item._initrequest()  # type: ignore[attr-defined]
        reports = [call_and_report(item, "setup", log=False)]
        if reports[0].passed:
            reports.append(call_and_report(item, "call", log=False))
        starvation = self.meter.since(since)
        repeats = not is_last and _repeats(reports, starvation)
        # the session as next item: what belongs to it stays, all below is torn down
        upcoming: Any = item.session if repeats else nextitem
        reports.append(call_and_report(item, "teardown", log=False, nextitem=upcoming))
        if reports[-1].failed and not repeats:
            starvation = self.meter.since(since)
            with contextlib.suppress(Exception):
                item.session._setupstate.teardown_exact(item.session)  # type: ignore[arg-type]
        item._request = False  # type: ignore[attr-defined]
        item.funcargs = None  # type: ignore[attr-defined]
        return reports, starvation

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """List the repetitions."""
        if self.repeated:
            terminalreporter.section("repeated because the machine was busy")
            for line in self.repeated:
                terminalreporter.line(line)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """End the meter's thread; a worker hands its list to the run."""
        self.meter.stop()
        if hasattr(session.config, "workeroutput"):
            session.config.workeroutput["repeated"] = self.repeated

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take over the list of a worker."""
        self.repeated += getattr(node, "workeroutput", {}).get("repeated", [])


def _repeats(reports: list[Report], starvation: Starvation) -> bool:
    return any(report.failed for report in reports) and starvation.is_starved


def _mark_as_starved(reports: list[Report], starvation: Starvation) -> None:
    """Say in the failure that the machine was too busy, and by how much."""
    text = f"the machine was too busy in each of {MAX_ATTEMPTS} attempts: {starvation}"
    for report in reports:
        if report.failed:
            report.sections.append(("starved of processor time", text))
            crash = getattr(report.longrepr, "reprcrash", None)
            if crash is not None:
                crash.message = f"[{text}] {crash.message}"


def _wait_until_quiet(patience: float) -> None:
    deadline = time.monotonic() + patience
    before = read_accounts()
    while time.monotonic() < deadline:
        time.sleep(0.5)
        now = read_accounts()
        if now.since(before).others < MIN_OTHERS:
            return
        before = now


@contextlib.contextmanager
def _ahead_of_others() -> Iterator[None]:
    """Run this thread, and all threads and processes that it starts, ahead of other programs if we may."""
    before, group_before = os.getpriority(os.PRIO_PROCESS, 0), _session_priority()
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, min(before, REPEAT_PRIORITY))
        _set_session_priority(min(group_before, REPEAT_PRIORITY))
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, before)
        with contextlib.suppress(OSError):
            _set_session_priority(group_before)


# Linux shares processors among sessions first (autogroups), within which alone a process's nice value counts
SESSION_GROUP = Path("/proc/self/autogroup")


def _session_priority() -> int:
    """The nice value of our session, 0 where sessions have none."""
    try:
        return int(SESSION_GROUP.read_text().split()[-1])
    except (OSError, ValueError, IndexError):
        return 0


def _set_session_priority(nice: int) -> None:
    """Raises OSError where we may not."""
    if SESSION_GROUP.exists():
        SESSION_GROUP.write_text(str(nice))


@contextlib.contextmanager
def _timeout_of_its_own(item: pytest.Item) -> Iterator[None]:
    """Let pytest-timeout count from the start of this attempt."""
    hooks = item.config.pluginmanager.hook
    timeouts = item.config.pluginmanager.get_plugin("timeout")
    if timeouts is not None:
        hooks.pytest_timeout_cancel_timer(item=item)
        settings = timeouts._get_item_settings(item)
        if settings.timeout and not settings.func_only:
            hooks.pytest_timeout_set_timer(item=item, settings=settings)
    yield


def pytest_configure(config: pytest.Config) -> None:
    """Register the plug-in; pytest calls this where the module is listed in `pytest_plugins`."""
    config.pluginmanager.register(RealtimePlugin(), "alula-realtime")
