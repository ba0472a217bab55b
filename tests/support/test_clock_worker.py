"""Among the workers of one run a single one flies against the clock, ahead of those that compute."""

from __future__ import annotations

import ast
import os
from pathlib import Path

import pytest

from tests.support.clock_worker import BEHIND, FIRST

pytest_plugins = ("pytester",)
ROOT = Path(__file__).parents[2]
REPEATS_ONLY = "@pytest.mark.realtime(repeats_only=True)"

TESTS = """
import os, pytest, time
{mark}
@pytest.mark.parametrize("number", range(3))
def test_takes_time(number):
    began = time.monotonic()
    time.sleep(0.1)
    with open({notes!r}, "a") as file:
        print([{mark!r}, os.environ["PYTEST_XDIST_WORKER"], began, os.nice(0)], file=file)
"""


@pytest.fixture
def notes(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Files a to f, of which b and e fly against the clock and f only repeats itself; where their tests make notes."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makeconftest('pytest_plugins = ("tests.support.clock_worker",)')
    pytester.makeini("[pytest]\nmarkers = realtime: against the clock\naddopts = -p no:dash")
    path = pytester.path / "notes"
    for name, mark in zip(
        "abcdef", ("", "@pytest.mark.realtime", "", "", "@pytest.mark.realtime", REPEATS_ONLY), strict=True
    ):
        pytester.makepyfile(**{f"test_{name}": TESTS.format(mark=mark, notes=str(path))})
    return path


def noted(path: Path) -> list[tuple[str, str, float, int]]:
    """Mark, worker, time at the start and nice value of each test, in the order in which they began."""
    return sorted((ast.literal_eval(line) for line in path.read_text().splitlines()), key=lambda note: note[2])


def test_tests_against_the_clock_are_the_first_workers_and_come_first(pytester: pytest.Pytester, notes: Path) -> None:
    pytester.runpytest_subprocess("-n", "3").assert_outcomes(passed=18)
    flown = [note for note in noted(notes) if note[0] == "@pytest.mark.realtime"]
    assert [worker for _, worker, _, _ in flown] == [FIRST] * 6
    own = [note[0] for note in noted(notes) if note[1] == FIRST]
    assert own[:6] == ["@pytest.mark.realtime"] * 6


def test_the_others_compute_behind_it(pytester: pytest.Pytester, notes: Path) -> None:
    pytester.runpytest_subprocess("-n", "3").assert_outcomes(passed=18)
    values = {worker: nice for _, worker, _, nice in noted(notes)}
    behind = min(os.nice(0) + BEHIND, 19)  # this test may itself run behind
    assert values == {FIRST: os.nice(0), "gw1": behind, "gw2": behind}


def test_one_worker_does_all(pytester: pytest.Pytester, notes: Path) -> None:
    pytester.runpytest_subprocess("-n", "1").assert_outcomes(passed=18)
    assert {note[1] for note in noted(notes)} == {FIRST}
