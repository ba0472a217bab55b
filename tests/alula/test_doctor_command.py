"""`alula doctor` lists the computer's state as a table or as JSON; its exit code says whether a flight is possible."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest

from simulation.mock_process import free_port
from tests.support.command_line import Run, command_line

NAMES = {
    "compiler",
    "cache folder",
    "SIMD",
    "real-time scheduling",
    "autogroup",
    "memory lock",
    "clock rate",
    "throttling",
    "clock source",
    "link",
}


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return command_line(monkeypatch, capsys)


def test_every_line_has_a_state_a_figure_and_advice_where_it_is_not_ok(run: Run) -> None:
    code, shown, _ = run("doctor", "--link", f"udpin:127.0.0.1:{free_port()}", "--json")
    report = json.loads(shown)
    assert (code, report["can_fly"]) == (0, True)
    assert {check["name"] for check in report["checks"]} == NAMES
    for check in report["checks"]:
        assert check["state"] in ("ok", "warning")
        assert check["measured"]
        assert check["advice"] or check["state"] == "ok"
    assert "alula_version" in report


def test_a_problem_ends_with_4_and_is_named(run: Run) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        link = f"udpin:127.0.0.1:{other.getsockname()[1]}"
        code, shown, wrong = run("doctor", "--link", link)
    assert code == 4
    assert "problem" in shown
    assert "is taken" in shown
    assert "the reasons are in the report (link)" in wrong
    assert shown.splitlines()[-1] == f"next: alula doctor --link {link}"


def test_a_link_that_cannot_be_one_is_a_wrong_request(run: Run) -> None:
    assert run("doctor", "--link", "nonsense")[0] == 2


def test_a_folder_that_is_no_bundle_ends_with_4(run: Run, tmp_path: Path) -> None:
    code, shown, _ = run("doctor", "--link", f"udpin:127.0.0.1:{free_port()}", "--bundle", tmp_path, "--json")
    problems = [check for check in json.loads(shown)["checks"] if check["state"] == "problem"]
    assert code == 4
    assert [check["name"] for check in problems] == ["bundle"]
