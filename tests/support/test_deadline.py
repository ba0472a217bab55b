"""A deadline leaves out what the host withheld, and nothing else."""

from __future__ import annotations

import pytest

from simulation.starvation import Accounts
from tests.support import deadline
from tests.support.deadline import Deadline, wait_until


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Time and the wait of a thread of ours, both set by the test."""
    now = {"time": 100.0, "wait": 0.0}
    monkeypatch.setattr(deadline, "read_accounts", lambda: Accounts(now["time"], {1: (0.0, now["wait"])}, 0.0, 0.0))
    monkeypatch.setattr(deadline.time, "monotonic", lambda: now["time"])
    return now


def test_it_passes_after_its_time(clock: dict[str, float]) -> None:
    limit = Deadline(5.0)
    clock["time"] = 104.9
    assert not limit.passed
    clock["time"] = 105.1
    assert limit.passed


def test_time_without_a_processor_does_not_count(clock: dict[str, float]) -> None:
    limit = Deadline(5.0)
    clock.update(time=107.0, wait=3.0)
    assert not limit.passed
    clock.update(time=109.0)
    assert limit.passed


def test_waiting_in_vain_ends_with_an_error() -> None:
    wait_until(lambda: True, 0.0)
    with pytest.raises(AssertionError, match="within 0 s"):
        wait_until(lambda: False, 0.0)
