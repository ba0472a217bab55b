"""Reports of members reach the process that waits for them."""

from __future__ import annotations

import os
import signal
import threading
from functools import partial

import pytest

from flights.parallel import parallel_map
from training.reports import Progress, Report, progress_channel


def report_of(member: int, step: int) -> Report:
    return Report(member, step, 3, 1.0, None, 1.0, 1.0, 1e-3)


def run_member(member: int, *, report: Progress) -> int:
    for step in (1, 2, 3):
        report(report_of(member, step))
    return member


def test_every_report_of_other_processes_arrives_in_order() -> None:
    reports: list[Report] = []
    with progress_channel(reports.append) as report:
        members = sorted(index for index, _ in parallel_map(partial(run_member, report=report), [0, 1], jobs=2))
    assert members == [0, 1]
    for member in members:
        assert [one for one in reports if one.member == member] == [report_of(member, step) for step in (1, 2, 3)]


def test_an_interrupt_while_the_channel_opens_ends_its_thread_first(monkeypatch: pytest.MonkeyPatch) -> None:
    start, wrong = threading.Thread.start, []

    def start_and_interrupt(thread: threading.Thread) -> None:
        start(thread)
        if thread.name == "training progress":
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(threading.Thread, "start", start_and_interrupt)
    monkeypatch.setattr(threading, "excepthook", wrong.append)
    with pytest.raises(KeyboardInterrupt), progress_channel(lambda report: None):
        pass
    assert wrong == []
    assert "training progress" not in {thread.name for thread in threading.enumerate()}
