"""`alula studio`: what it refuses before a page is there."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from studio.case.case import Case
from tests.support.command_line import Run, command_line


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    return command_line(monkeypatch, capsys)


def test_a_vehicle_without_a_log_is_refused(run: Run) -> None:
    code, _, wrong = run("studio", "--vehicle", "px4_sih")
    assert code == 2
    assert "without a log" in wrong


def test_logs_for_a_case_that_is_there_are_refused(run: Run, tmp_path: Path) -> None:
    Case.create(tmp_path / "mine").close()
    (tmp_path / "log.csv").write_text("t\n1\n")
    code, _, wrong = run("studio", "log.csv", "--case", "mine")
    assert code == 2
    assert "holds a case already" in wrong


def test_a_case_that_is_open_elsewhere_is_refused(run: Run, tmp_path: Path) -> None:
    other = Case.create(tmp_path / "mine")
    code, _, wrong = run("studio", "--case", "mine")
    other.close()
    assert code == 2
    assert "open in another studio" in wrong


def test_a_log_that_does_not_exist_is_refused_and_no_page_is_served(run: Run, tmp_path: Path) -> None:
    code, _, wrong = run("studio", "nowhere.ulg")
    assert code == 2
    assert "nowhere.ulg" in wrong


def test_a_port_that_is_taken_is_refused(run: Run) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, _, wrong = run("studio", "--port", str(port))
    assert code == 2
    assert f"port {port} cannot be used" in wrong
