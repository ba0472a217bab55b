"""Durations are written on disk, and a long test without a reason is listed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.durations import Durations

pytest_plugins = ("pytester",)
ROOT = Path(__file__).parents[2]

PLUGIN = """
from pathlib import Path
from tests.support import durations
from tests.support.durations import Durations, pytest_runtest_setup

durations.LONG = 0.1

def pytest_configure(config):
    config.addinivalue_line("markers", "long: why")
    config.pluginmanager.register(Durations(Path({path!r})), "durations")
"""
TESTS = """
import pytest, time
def test_quick(): ...
def test_slow_without_a_word(): time.sleep(0.15)
@pytest.mark.long("it sleeps")
def test_slow_with_a_reason(): time.sleep(0.15)
def test_fails(): assert False
"""


@pytest.fixture
def ended(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> tuple[list[str], dict]:
    """Lines of a run of four tests, and what it wrote."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    path = tmp_path / "durations.json"
    pytester.makeconftest(PLUGIN.format(path=str(path)))
    pytester.makepyfile(TESTS)
    result = pytester.runpytest_subprocess("-p", "no:dash", "-p", "no:cacheprovider")
    return result.outlines, json.loads(path.read_text())


def test_long_tests_without_a_reason_are_listed(ended: tuple[list[str], dict]) -> None:
    lines, _ = ended
    start = next(place for place, line in enumerate(lines) if "no reason beside it" in line)
    listed = [line for line in lines[start + 1 :] if line.startswith("0 s ")]
    assert [line.split("::")[1] for line in listed] == ["test_slow_without_a_word"]


def test_seconds_and_failures_are_kept(ended: tuple[list[str], dict]) -> None:
    _, written = ended
    assert written["phases"] == ["setup", "call", "teardown"]
    seconds = {name.split("::")[1]: phases for name, phases in written["seconds"].items()}
    assert seconds["test_slow_with_a_reason"][1] == pytest.approx(0.15, abs=0.1)
    assert [name.split("::")[1] for name in written["failed"]] == ["test_fails"]


def test_a_run_that_is_cut_off_leaves_what_it_had(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.support.durations.BETWEEN_WRITES", 0.0)
    durations = Durations(tmp_path / "durations.json")
    durations.pytest_runtest_logreport(
        pytest.TestReport("test_a", ("", 0, ""), {}, "passed", None, "call", duration=2.0)
    )
    assert json.loads((tmp_path / "durations.json").read_text())["seconds"] == {"test_a": [0.0, 2.0, 0.0]}
