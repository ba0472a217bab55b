"""Inputs after public reports of people who do this job: what the answer says and what it must not say.

The cases are data: tests/data/field/cases.toml. Heartbeats of strangers on a link, another such report, are held by
tests/runtime/link/test_one_vehicle.py.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import msgspec
import pytest

from tests.support.command_line import Run, command_line

FIELD = Path(__file__).parents[1] / "data" / "field"


class Case(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A question to the command line and its right answer.

    files: below the folder of cases.
    options: those that are files there are given with their path.
    exit: code.
    says, never: parts that the answer has, and has not.
    matches: regular expression that the answer holds.
    repaired: parts of the answer of `--repair`, empty where nothing is to repair.
    """

    name: str
    files: tuple[str, ...]
    command: str = "inspect"
    options: tuple[str, ...] = ()
    exit: int = 0
    says: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    matches: str = ""
    repaired: tuple[str, ...] = ()

    @property
    def words(self) -> list[str | Path]:
        """The command line."""
        options = [FIELD / option if (FIELD / option).is_file() else option for option in self.options]
        return [self.command, *(FIELD / file for file in self.files), *options]


CASES = msgspec.convert(tomllib.loads((FIELD / "cases.toml").read_text(encoding="utf-8"))["cases"], list[Case])


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    monkeypatch.chdir(tmp_path)
    return command_line(monkeypatch, capsys)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_answer_is_right(case: Case, run: Run) -> None:
    code, shown, wrong = run(*case.words)
    answer = shown + wrong
    assert "Traceback" not in answer
    assert code == case.exit, answer
    assert [part for part in case.says if part not in answer] == [], answer
    assert re.search(case.matches, answer), answer
    assert [part for part in case.never if part in answer] == [], answer


@pytest.mark.parametrize("case", [case for case in CASES if case.repaired], ids=lambda case: case.name)
def test_the_proposed_repair_repairs(case: Case, run: Run, tmp_path: Path) -> None:
    code, shown, wrong = run(*case.words, "--repair", tmp_path / "repaired.toml")
    assert code == 0, wrong
    assert [part for part in case.repaired if part not in shown] == [], shown


def test_every_input_has_a_case() -> None:
    named = {FIELD / word for case in CASES for word in (*case.files, *case.options)}
    inputs = {path for path in FIELD.rglob("*") if path.is_file() and path.parent != FIELD}
    assert inputs <= named
