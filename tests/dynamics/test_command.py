"""Artefacts record the command that a shell would take again."""

from __future__ import annotations

import sys

import pytest

from dynamics.command import command_line


@pytest.mark.parametrize(
    ("arguments", "command"),
    [
        (["alula", "add", "a log.csv"], "alula add 'a log.csv'"),
        (["/home/me/.venv/bin/alula", "train"], "alula train"),
        (["/home/me/src/alula/__main__.py", "train"], "alula train"),
        (["study.py", "--all"], "python study.py --all"),
    ],
)
def test_a_script_of_the_users_is_not_taken_for_the_command_line(
    monkeypatch: pytest.MonkeyPatch, arguments: list[str], command: str
) -> None:
    monkeypatch.setattr(sys, "argv", arguments)
    assert command_line() == command
