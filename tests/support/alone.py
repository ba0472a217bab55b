"""Several workers of one test run: a test against the clock has the machine to itself.

Every test of a worker holds a lock of the run, those marked `realtime` exclusively, from the first of a row to its
last, all others shared, as those marked `realtime(alone=False)`. Whoever waits for it stands in a turnstile, so that
nobody is overtaken. A run without workers has no lock.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Generator
from pathlib import Path

import pytest


class MachineLock:
    """Held by many or by one, in the order of asking; the kernel releases it with its process."""

    def __init__(self, path: Path) -> None:
        self._turnstile = path.with_suffix(".turnstile").open("w")
        self._lock = path.open("w")

    def acquire(self, *, exclusive: bool) -> None:
        """Wait for it."""
        fcntl.flock(self._turnstile, fcntl.LOCK_EX)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH)
        finally:
            fcntl.flock(self._turnstile, fcntl.LOCK_UN)

    def release(self) -> None:
        """Let others have it."""
        fcntl.flock(self._lock, fcntl.LOCK_UN)

    def close(self) -> None:
        """Release it for good."""
        self._lock.close()
        self._turnstile.close()


class AlonePlugin:
    """Takes and gives back the lock around the tests of a worker."""

    def __init__(self, lock: MachineLock) -> None:
        self._lock = lock
        self._alone = False

    # outermost, so that the time spent waiting is none of the test's
    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(
        self, item: pytest.Item, nextitem: pytest.Item | None
    ) -> Generator[None, object, object]:
        """Hold the lock while a test runs."""
        if not self._alone:
            self._alone = runs_alone(item)
            self._lock.acquire(exclusive=self._alone)
        try:
            return (yield)
        finally:
            if not (self._alone and runs_alone(nextitem)):
                self._alone = False
                self._lock.release()

    def pytest_unconfigure(self) -> None:
        """Let the lock go with the session."""
        self._lock.close()


def runs_alone(item: pytest.Item | None) -> bool:
    """Whether a test runs against the clock, so that others must not run beside it."""
    marker = item.get_closest_marker("realtime") if item is not None else None
    return marker is not None and bool(marker.kwargs.get("alone", True))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with tests that run alone come last: between others each of them waits for one to end, and others wait."""
    last = {item.path for item in items if runs_alone(item)}
    items.sort(key=lambda item: item.path in last)


def pytest_configure(config: pytest.Config) -> None:
    """Register the plug-in in the workers of pytest-xdist."""
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID")
    if run and os.environ.get("PYTEST_XDIST_WORKER"):
        lock = MachineLock(Path(tempfile.gettempdir()) / f"alula-tests-{run}.lock")
        config.pluginmanager.register(AlonePlugin(lock), "alula-alone")
