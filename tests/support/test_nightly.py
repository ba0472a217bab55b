"""What was moved into the nightly set has a guard that runs with every change."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.support.nightly import mark, read_table

pytest_plugins = ("pytester",)
TESTS = """
import pytest
@pytest.mark.parametrize("size", [1, 2])
def test_it_holds(size): ...
@pytest.mark.slow
def test_it_holds_for_long(): ...
"""


def collected(pytester: pytest.Pytester, table: list[dict[str, Any]], *, complete: bool = True) -> list[str]:
    """Names of the tests that are slow with a table."""
    (pytester.path / "pytest.ini").write_text("[pytest]\nmarkers = slow: takes long\n")
    items, _ = pytester.inline_genitems(pytester.makepyfile(test_room=TESTS), "-p", "no:dash")
    mark(items, table, pytester.path, complete=complete)
    return [item.name for item in items if item.get_closest_marker("slow")]


def group(test: str, guard: str) -> dict[str, Any]:
    """A group of one test and one guard of this file."""
    return {"tests": [f"test_room.py::{test}"], "guards": [f"test_room.py::{guard}"]}


def test_a_second_case_is_slow_and_its_guard_is_not(pytester: pytest.Pytester) -> None:
    slow = collected(pytester, [group("test_it_holds[2]", "test_it_holds[1]")])
    assert slow == ["test_it_holds[2]", "test_it_holds_for_long"]


@pytest.mark.parametrize(
    ("test", "guard", "message"),
    [
        ("test_gone", "test_it_holds[1]", "no test is named test_room.py::test_gone"),
        ("test_it_holds[2]", "test_gone", "which is to guard test_room.py::test_it_holds"),
        ("test_it_holds[2]", "test_it_holds_for_long", "is slow, and is to guard"),
        ("test_it_holds[2]", "test_it_holds[2]", "is slow, and is to guard"),
    ],
)
def test_a_group_without_a_test_or_a_guard_refuses_the_run(
    pytester: pytest.Pytester, test: str, guard: str, message: str
) -> None:
    with pytest.raises(pytest.UsageError, match=message.replace("[", r"\[")):
        collected(pytester, [group(test, guard)])


def test_a_run_of_a_few_tests_is_not_refused_for_the_others(pytester: pytest.Pytester) -> None:
    assert collected(pytester, [group("test_gone", "test_it_holds[1]")], complete=False) == ["test_it_holds_for_long"]


def test_every_group_says_why() -> None:
    for listed in read_table():
        assert listed["tests"]
        assert listed["guards"]
        assert len(listed["why"].split()) > 3
    assert Path(__file__).parent.parent.joinpath("nightly.toml").exists()
